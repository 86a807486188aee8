"""The field of cells and tilings: continuous, periodic, the same on every grid and however it is cut."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.assembly.gather import sample_exact
from sppm_pipeline.method.fields import tiling
from sppm_pipeline.method.fields.microstructure import CUTOFF
from sppm_pipeline.method.fields.scalar_field import RepeatedField
from sppm_pipeline.method.fields.tiling import Tiling, sampling_tables
from sppm_pipeline.method.stages.check_connectivity import CheckConnectivity
from sppm_pipeline.method.stages.tile_periodic import PeriodicTiling
from sppm_pipeline.services.bit_rows import unpack
from sppm_pipeline.services.grid import Grid, cell_centers, cell_nodes
from sppm_pipeline.testing.plain_context import PlainContext

BOUND = 60 * CUTOFF
"""Tens of kernels may be left out at a point, each below the cut-off."""


def exact(tiling, grid):
    micro = tiling.tileset.micro
    return sample_exact(micro.pieces, tiling.arrays, grid, 1e-9) - np.float32(micro.level)


@pytest.mark.parametrize("n", [7, 16, 32])
def test_opposite_faces_of_a_cell_are_equal_to_the_last_bit(cell, n):
    values = cell.sample(cell_nodes(n))
    for axis in range(3):
        assert np.array_equal(np.take(values, 0, axis), np.take(values, -1, axis))
    moved = cell.sample(Grid((3.0, -2.0, 7.0), (1 / n,) * 3, (n + 1,) * 3))
    assert np.abs(moved - values).max() < BOUND


def test_opposite_faces_of_a_periodic_tiling_are_equal_to_the_last_bit(cell):
    laid = PeriodicTiling(cells=(2, 1, 3)).run(PlainContext(), cell, None)
    for grid in (cell_nodes(8, (2, 1, 3)), Grid((0.1, 0.2, 0.3), (1 / 7, 1 / 9, 1 / 5), (15, 10, 16))):
        values = laid.sample(grid)
        for axis in range(3):
            assert np.array_equal(np.take(values, 0, axis), np.take(values, -1, axis))


def test_one_cell_is_an_assembly_of_itself(cell):
    laid = PeriodicTiling(cells=(2, 1, 3)).run(PlainContext(), cell, None)
    grid = cell_centers(12)
    assert laid.periodic
    for values in (laid.sample(grid), laid.sample(Grid((1 + 1 / 24, 1 / 24, 2 + 1 / 24), grid.spacing, grid.shape))):
        assert np.abs(values - cell.sample(grid)).max() < BOUND


def test_a_tile_of_the_set_is_an_assembly_of_itself(wang):
    laid = PeriodicTiling(cells=(2, 2, 2), tile=5).run(PlainContext(), wang, None)
    grid = cell_centers(12)
    moved = wang.micro.level - laid.tileset.micro.level  # the level is cut anew for the tiles that were laid
    assert moved != 0
    assert np.abs(laid.sample(grid) - moved - wang.micro.alone(5, (1, 0, 1)).sample(grid)).max() < BOUND


@pytest.mark.parametrize("name", ["wang_tiling", "free_tiling"])
def test_patches_and_exact_kernels_agree_also_across_the_cell_borders(name, request):
    tiling = request.getfixturevalue(name)
    nodes = cell_nodes(8, tiling.cells)
    assert np.abs(tiling.sample(nodes) - exact(tiling, nodes)).max() < BOUND
    tables = sampling_tables(tiling.tileset.micro.pieces)
    assert any(isinstance(key, tuple) and 8 in key for key in tables), "patches were not used"
    beyond = Grid((-0.5, -0.25, -1.0), (1 / 8,) * 3, (20, 20, 20))
    assert np.abs(tiling.sample(beyond) - exact(tiling, beyond)).max() < BOUND


@pytest.mark.parametrize("name", ["wang_tiling", "free_tiling"])
def test_the_field_is_continuous_over_the_cell_borders(name, request):
    """Just before and just behind each lattice plane it is the same, whatever the neighbors are."""
    tiling = request.getfixturevalue(name)
    eps = 1e-7
    for axis in range(3):
        for plane in range(1, tiling.cells[axis]):
            origin, spacing, shape = [0.03] * 3, [0.11] * 3, [9 * c for c in tiling.cells]
            origin[axis], spacing[axis], shape[axis] = plane - eps, 2 * eps, 2
            values = tiling.sample(Grid(tuple(origin), tuple(spacing), tuple(shape)))
            before, behind = (np.take(values, i, axis) for i in (0, 1))
            assert np.abs(before - behind).max() < BOUND


@pytest.mark.parametrize("name", ["cell", "wang_tiling", "free_tiling"])
def test_commensurate_and_other_grids_agree_where_they_share_points(name, request):
    field = request.getfixturevalue(name)
    fine = cell_nodes(12)
    values = field.sample(fine)
    lower_half = Grid((0, 0, 0), (1 / 6, 1 / 12, 1 / 4), (7, 13, 4))
    assert np.abs(field.sample(lower_half) - values[::2, :, :10:3]).max() < BOUND
    centers = cell_centers(6)
    assert np.abs(field.sample(centers) - values[1::2, 1::2, 1::2]).max() < BOUND


def cleaned(cell):
    """A field with islands removed."""
    return CheckConnectivity(resolution=16).run(PlainContext(), cell.with_level(0.62))


@pytest.fixture(scope="module")
def fields(cell, wang_tiling, free_tiling):
    fresh = Tiling(wang_tiling.tileset, wang_tiling.arrays, 4.0)
    made = cleaned(cell.with_level(cell.level))
    return {
        "cell": cell,
        "tile": wang_tiling.tileset.micro.alone(3, (0, 1, 1)),
        "wang": wang_tiling,
        "free": free_tiling,
        "same": fresh,
        "cleaned": made,
        "repeated": RepeatedField(made, (2, 2, 2), 4.0),
    }


GRIDS = [
    cell_centers(10, (2, 2, 2)),
    cell_nodes(9),
    Grid((0.013, 0.4, 0.27), (0.057, 0.061, 0.037), (20, 17, 23)),
    Grid((0.05, 0.05, 1 / 60), (0.1, 0.1, 1 / 30), (20, 20, 33)),
    cell_nodes(4, (2, 3, 5)),
]


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("name", ["cell", "tile", "wang", "free", "cleaned", "repeated"])
def test_solid_is_the_sign_and_slabs_and_threads_change_no_bit(fields, name, grid):
    field = fields[name]
    values = field.sample(grid)
    assert values.dtype == np.float32
    assert values.shape == grid.shape
    assert values.flags.f_contiguous
    assert values.tobytes() == field.sample(grid, threads=2).tobytes()
    solid = field.solid(grid)
    assert solid.dtype == np.uint8
    assert np.array_equal(solid, values < 0)
    assert 0 < solid.mean() < 1
    assert solid.tobytes() == field.solid(grid, threads=2).tobytes()
    nz = grid.shape[2]
    assert np.array_equal(unpack(field.solid_bits(grid, 1, nz, 2), grid.shape[0]).T, solid[:, :, 1:])
    for step in (1, 5):
        parts = [(k, min(k + step, nz)) for k in range(0, nz, step)]
        assert np.concatenate([field.solid_layers(grid, *p, threads=2) for p in parts], 2).tobytes() == solid.tobytes()
        assert np.concatenate([field.sample_layers(grid, *p) for p in parts], 2).tobytes() == values.tobytes()


def test_a_field_without_a_size_says_so(cell, wang_tiling):
    with pytest.raises(DesignError, match="physical size"):
        cell.physical_edge()
    assert wang_tiling.physical_edge() == 4.0


def test_many_interiors_have_to_be_laid_out(wang):
    with pytest.raises(ValueError, match="laid out"):
        wang.micro.sample(cell_centers(4))


def test_the_level_moves_the_field_and_not_the_kernels(cell):
    grid = cell_centers(8)
    assert np.abs(cell.with_level(0.5).sample(grid) - (cell.sample(grid) + cell.level - 0.5)).max() < 1e-6


def test_large_patches_have_sixteen_bits_for_solids_alone(wang_tiling, monkeypatch):
    grid = cell_centers(20, wang_tiling.cells)
    field = wang_tiling.exactly()
    solid, values = field.solid(grid), field.sample(grid)
    assert field.patches(20, 0.5, solid=True).bank.solid_level is None
    monkeypatch.setattr(tiling, "SMALL_BANK", 0)
    monkeypatch.setattr(tiling, "USES_OF_A_PATCH", 0)
    monkeypatch.setattr(tiling, "LASTING_USES", 0)
    assert field.patches(20, 0.5).bank.solid_level is None
    assert field.patches(20, 0.5, solid=True).bank.data.dtype == np.int16
    assert field.sample(grid).tobytes() == values.tobytes()
    coarse = field.solid(grid)
    assert (coarse != solid).mean() < 1e-4
    # half a unit for each of eight patches, and what was trimmed
    bound = 8 * (field.solid_below / 32767 / 2 + CUTOFF)
    assert (np.abs(values)[coarse != solid] <= bound).all()
    assert np.array_equal(unpack(field.solid_bits(grid, 0, grid.shape[2]), grid.shape[0]).T, coarse)
    other = field.cut_at(0.01)  # another level has patches of its own
    assert (other.solid(grid) != (values < 0.01)).mean() < 1e-4
    kept = [bank.solid_level for bank in sampling_tables(field.tileset.micro.pieces).values() if hasattr(bank, "data")]
    assert len([level for level in kept if level is not None]) == 1  # and they take the place of those before
    monkeypatch.setattr(tiling, "LARGE_BANK", 0)
    assert not field.has_patches(20, 0.5)
    assert field.patches(20, 0.5, solid=True) is None
