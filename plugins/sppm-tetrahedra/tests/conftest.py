"""Lattices of known functions and of noise, and small structures."""

import numpy as np
import pytest
from hypothesis import settings
from sppm_tetrahedra.numerics.lattice import doubled_grid

from sppm_pipeline import Length, SurfaceMesh
from sppm_pipeline.method.part import primitive_meshes
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.method.stages.tile_wang_3color import WangTiling
from sppm_pipeline.method.stages.tileset_wang_3color import WangTileSet
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of

# the same examples each time, however long a busy machine takes for one of them
settings.register_profile("tetrahedra", deadline=None, derandomize=True)
settings.load_profile("tetrahedra")


def lattice_of(function, n, periodic=True):
    """A function of x, y, z in [0, 1]^3, sampled at n cubes an edge."""
    a, c, e = np.arange(n + 1) / n, (np.arange(n) + 0.5) / n, np.array([0.0, 1.0])

    def at(z, y, x):
        x, y, z = np.broadcast_arrays(x[None, None, :], y[None, :, None], z[:, None, None])
        return np.asarray(function(x, y, z), np.float32)

    return doubled_grid(at(a, a, a), at(c, c, c), (at(c, c, e), at(c, e, c), at(e, c, c)), periodic)


def noise_of(n, seed, periodic=True, solid=0.5, spread=0.5):
    """Independent values, their sizes spread over so many decades."""
    rng = np.random.default_rng(seed)

    def draw(*shape):
        size = 10 ** rng.uniform(-spread, 0, shape)
        return np.where(rng.random(shape) < solid, -size, size).astype(np.float32)

    faces = draw(n, n, 2), draw(n, 2, n), draw(2, n, n)
    return doubled_grid(draw(n + 1, n + 1, n + 1), draw(n, n, n), faces, periodic)


@pytest.fixture(scope="session")
def lattice():
    return lattice_of


@pytest.fixture(scope="session")
def noise():
    return noise_of


def small_recipe():
    """A recipe whose cells are drawn in milliseconds, as in the tests of the program."""
    return recipe_of(
        MirroredFaces(count=9, spacing=Length(0.2)),
        DartThrowing(count=12, spacing=Length(0.2)),
        BoundedDegreeSubgraph(degree=(2, 4), mode="greedy"),
        GaussianField(pore_radius=Length(0.14), tunnel_radius=Length(0.05)),
    )


@pytest.fixture(scope="session")
def recipe():
    return small_recipe


@pytest.fixture(scope="session")
def cell():
    """One periodic cell."""
    return small_recipe().run(PlainContext(3))


@pytest.fixture(scope="session")
def wang_tiling():
    """4 x 3 x 3 cells of 4 mm by the paper's rules."""
    wang = WangTileSet(colors=2, porosity=0.5, resolution=24, tolerance=0.01).run(PlainContext(4), small_recipe())
    return WangTiling(cells=(4, 3, 3), cell=Length(4, "mm")).run(PlainContext(5), wang, None)


@pytest.fixture(scope="session")
def ball():
    """A ball with a diameter of 10 mm around (5, 5, 5)."""
    return SurfaceMesh(*primitive_meshes.ball_mesh((5.0, 5.0, 5.0), 5.0, 3), name="ball")
