"""Tetrahedra of cells, tilings and parts: volume, box, copies, order; and their boundary."""

import numpy as np
import pytest
from sppm_tetrahedra.numerics.quality import quality
from sppm_tetrahedra.stages.mesh_boundary import Boundary
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import ANGLES, IsosurfaceStuffing
from sppm_tetrahedra.volume_mesh import face_match, matched_nodes

from sppm_pipeline.errors import DesignError, ResourceError
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.services.mesh.measures import measure_surface
from sppm_pipeline.testing.plain_context import PlainContext


def mesh(field, threads=1, **options):
    context = PlainContext(threads=threads)
    made = IsosurfaceStuffing(**{"resolution": 20, **options}).run(context, field)
    made.check()
    found = quality(made.nodes, made.cells)
    assert found.inverted == 0
    assert found.minimum_dihedral >= ANGLES[0] - 1e-6
    assert found.maximum_dihedral <= ANGLES[1] + 1e-6
    return made, context


def surface(made):
    context = PlainContext()
    skin = Boundary().run(context, made)
    skin.check()
    assert context.reported["closed"]
    found = measure_surface(skin.vertices, skin.faces)
    assert found.volume == pytest.approx(made.volume)
    return skin, found


def test_a_periodic_cell(cell):
    made, context = mesh(cell, resolution=32)
    assert made.volume == pytest.approx(cell.solid(cell_centers(64)).mean(), rel=0.03)
    assert made.matched
    assert made.box.tolist() == [[0, 0, 0], [1, 1, 1]]
    match = face_match(made.nodes, made.cells, made.box)
    assert (match.matched > 100).all()
    assert not match.mismatched.any()
    apart = made.nodes - made.nodes[matched_nodes(made.nodes, made.box)]
    assert set(np.unique(apart)) == {0.0, 1.0}
    assert any("cell size" in warning for warning in context.warnings)
    skin, _ = surface(made)
    assert skin.lower.tolist() == [0, 0, 0]
    assert skin.upper.tolist() == [1, 1, 1]


def test_finer_is_nearer(cell):
    exact = float((cell.sample(cell_centers(128)) < 0).mean())
    errors = [abs(mesh(cell, resolution=n, islands="keep")[0].volume - exact) for n in (16, 32, 64)]
    assert errors[0] > 2 * errors[1] > 4 * errors[2]
    assert errors[2] < 0.005


def test_a_periodic_tiling_in_mm(cell):
    tiling = PeriodicTiling(cells=(2, 1, 1), cell=Length(3, "mm")).run(PlainContext(), cell, None)
    made, context = mesh(tiling, resolution=16)
    assert not [w for w in context.warnings if "cell size is written" in w]
    assert made.matched == tiling.periodic
    assert np.allclose(made.box, [[0, 0, 0], [6, 3, 3]])
    assert made.volume == pytest.approx(54 * tiling.solid(cell_centers(32, tiling.cells)).mean(), rel=0.06)


def test_a_stochastic_tiling_ends_at_the_planes_of_its_box(wang_tiling):
    made, _ = mesh(wang_tiling, resolution=16)
    assert not made.matched
    _, found = surface(made)
    assert np.array_equal(found.low, (0, 0, 0))
    assert np.array_equal(found.high, (16, 12, 12))


@pytest.mark.parametrize("skin", [0.0, 0.8])
def test_a_part_lies_in_its_domain(wang_tiling, ball, skin):
    part = Part(wang_tiling, ball, skin)
    made, _ = mesh(part)
    assert made.box is None
    away = np.linalg.norm(made.nodes - 5, axis=1)
    assert away.max() < 5.03
    h = 4 / 24
    voxels = part.solid(cell_centers(24, wang_tiling.cells)).sum() * h**3
    assert made.volume == pytest.approx(voxels, rel=0.05)
    surface(made)


def test_islands_go_or_stay(recipe):
    loose = recipe().run(PlainContext(5)).with_level(0.02)
    kept, context = mesh(loose, islands="keep")
    assert context.reported["removed_share"] == 0
    removed, context = mesh(loose)
    assert context.reported["removed_share"] > 0.01
    assert removed.volume == pytest.approx(kept.volume * (1 - context.reported["removed_share"]))


def test_quadratic_cells(cell):
    straight, _ = mesh(cell, resolution=12)
    curved, _ = mesh(cell, resolution=12, order=2)
    assert curved.cells.shape == (len(straight.cells), 10)
    assert np.array_equal(curved.cells[:, :4], straight.cells)
    assert curved.volume == straight.volume
    assert curved.matched
    assert not face_match(curved.nodes, curved.cells, curved.box).mismatched.any()
    surface(curved)


def test_threads_do_not_matter(wang_tiling, ball):
    part = Part(wang_tiling, ball)
    assert mesh(part, 1)[0].digest() == mesh(part, 3)[0].digest()


def test_nothing_to_mesh(cell):
    with pytest.raises(DesignError, match="no solid"):
        mesh(cell.with_level(1e-9))


def test_too_much_to_mesh(wang_tiling):
    with pytest.raises(ResourceError, match="limit"):
        mesh(wang_tiling, resolution=512)
