"""Meshes of cells, tilings and parts: closed, oriented, of the right volume."""

import numpy as np
import pytest

from sppm_pipeline.data.part import Part
from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.grid import cell_centres
from sppm_pipeline.numerics.surface.measures import components, measure_surface
from sppm_pipeline.stages.extract.marching_cubes import MarchingCubes
from sppm_pipeline.testing.plain_context import PlainContext


def mesh(field, **options):
    context = PlainContext()
    made = MarchingCubes(**{"resolution": 24, **options}).run(context, field)
    made.check()
    return made, measure_surface(made.vertices, made.faces), context


def test_a_cell(cell):
    made, found, context = mesh(cell)
    assert found.edges.closed
    assert found.volume == pytest.approx(cell.solid(cell_centres(48)).mean(), rel=0.02)
    assert made.vertices.min() == 0.0
    assert made.vertices.max() == 1.0
    assert "cell edge" in context.warnings[0]


def test_opposite_sides_of_a_cell_match(cell):
    made, _, _ = mesh(cell, islands="keep")
    for axis in range(3):
        sides = []
        for side in (0.0, 1.0):
            on = made.vertices[np.abs(made.vertices[:, axis] - side) < 1e-12]
            on = np.delete(on, axis, axis=1).round(12)
            inner = ((on > 1e-4) & (on < 1 - 1e-4)).all(1)  # the caps are joined along the edges of the box
            sides.append(np.unique(on[inner], axis=0))
        assert len(sides[0]) > 100
        assert np.array_equal(*sides)


@pytest.mark.parametrize("backend", ["compiled", "reference"])
def test_a_tiling_in_mm(wang_tiling, backend):
    made, found, context = mesh(wang_tiling, resolution=20, backend=backend, islands="keep")
    assert not context.warnings
    assert found.edges.bounds_solid
    solid = wang_tiling.solid(cell_centres(24, wang_tiling.cells)).mean() * np.prod(wang_tiling.cells) * 64
    assert found.volume == pytest.approx(solid, rel=0.03)
    assert np.allclose(made.lower, 0, atol=0.35)
    assert np.allclose(made.upper, [16, 12, 12], atol=0.35)
    if backend == "compiled":
        assert found.degenerate == 0
        assert np.allclose(made.lower, 0, atol=1e-9)
        assert np.allclose(made.upper, [16, 12, 12], atol=1e-9)


def test_both_backends_agree(cell):
    volumes = [mesh(cell, resolution=32, backend=b)[1].volume for b in ("compiled", "reference")]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.03)  # the reference rounds the cap off


@pytest.mark.parametrize("skin", [0.0, 0.8])
def test_a_part_is_closed_and_lies_in_its_domain(wang_tiling, ball, skin):
    part = Part(wang_tiling, ball, skin)
    made, found, _ = mesh(part, resolution=20, islands="keep")
    assert found.edges.closed
    assert np.linalg.norm(made.vertices - 5, axis=1).max() < 5.001
    h = 4 / 24
    voxels = part.solid(cell_centres(24, wang_tiling.cells)).sum() * h**3
    assert found.volume == pytest.approx(voxels, rel=0.05)


def test_islands_go_or_stay(cell):
    loose = cell.with_level(0.03)
    kept, _, _ = mesh(loose, islands="keep")
    removed, found, context = mesh(loose)
    assert context.reported["removed_share"] > 0.01
    assert components(removed.faces)[0] < components(kept.faces)[0]
    assert found.edges.closed


def test_nothing_to_mesh(cell):
    with pytest.raises(DesignError, match="no solid"):
        mesh(cell.with_level(1e-9))
