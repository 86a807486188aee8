"""The mesh of one cell, and copies of it that fill a lattice."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.features.surface.stages.extract_unit_cell import UnitCell
from sppm_pipeline.method.nouns.mesh import RepeatedMesh
from sppm_pipeline.method.stages.fill_implicit import ImplicitFill
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.mesh.measures import edge_counts, volume
from sppm_pipeline.testing.plain_context import PlainContext


@pytest.fixture(scope="module")
def lattice(cell):
    """2 x 3 x 1 copies of a cell of 4 mm."""
    return PeriodicTiling(cells=(2, 3, 1), cell=Length(4, "mm")).run(PlainContext(), cell, None)


@pytest.fixture(scope="module")
def repeated(lattice) -> RepeatedMesh:
    made = UnitCell(resolution=12).run(PlainContext(), lattice)
    made.check()
    return made


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.lexsort(points.round(9).T)]


def test_copies_of_a_cell_fill_the_lattice(lattice, repeated):
    whole = MarchingCubes(resolution=12).run(PlainContext(), lattice)
    assert repeated.offsets.tolist() == [[4.0 * i, 4.0 * j, 0.0] for i in range(2) for j in range(3)]
    assert edge_counts(repeated.mesh.faces).closed
    copies = repeated.whole()
    # caps bevel the edges of each cell a little
    assert volume(copies.vertices, copies.faces) == pytest.approx(volume(whole.vertices, whole.faces), rel=2e-3)
    assert np.allclose(copies.lower, whole.lower)
    assert np.allclose(copies.upper, whole.upper)
    assert repeated.summary()["copies"] == 6
    # opposite caps are equal (along z up to the bevels), so that copies touch without a gap
    vertices = repeated.mesh.vertices
    for axis in range(2):
        low, high = (vertices[np.isclose(vertices[:, axis], side, rtol=0, atol=1e-9)] for side in (0.0, 4.0))
        low, high = (np.delete(points, axis, 1) for points in (low, high))
        assert len(low)
        assert np.allclose(in_order(low), in_order(high), atol=1e-9)


def test_a_lone_cell_is_its_own_lattice(cell):
    made = UnitCell(resolution=8).run(PlainContext(), cell)
    assert made.offsets.tolist() == [[0, 0, 0]]


def test_a_lattice_around_a_part_stands_where_the_part_is(cell, ball):
    tiling = PeriodicTiling(cell=Length(2.5, "mm")).run(PlainContext(), cell, ball)
    made = UnitCell(resolution=8).run(PlainContext(), tiling)
    assert len(made.offsets) == 64
    assert np.allclose(made.whole().lower, 0, atol=1e-9)
    assert np.allclose(made.whole().upper, 10, atol=1e-9)


def test_different_cells_are_not_one(wang_tiling, wang, ball):
    with pytest.raises(DesignError, match="different cells") as caught:
        UnitCell().run(PlainContext(), wang_tiling)
    assert "tile.periodic" in caught.value.hint
    one = PeriodicTiling(cells=(2, 2, 2), cell=Length(4, "mm"), tile=3).run(PlainContext(), wang, None)
    assert len(UnitCell(resolution=8).run(PlainContext(), one).offsets) == 8


def test_a_part_is_not_made_of_copies(cell, ball):
    tiling = PeriodicTiling(cell=Length(2.5, "mm")).run(PlainContext(), cell, ball)
    part = ImplicitFill().run(PlainContext(), tiling, ball)
    with pytest.raises(DesignError, match="no cell that is repeated"):
        UnitCell().run(PlainContext(), part)


def test_copies_have_finite_places(repeated):
    with pytest.raises(ValueError, match="finite"):
        RepeatedMesh(repeated.mesh, np.array([[np.nan, 0, 0]])).check()
