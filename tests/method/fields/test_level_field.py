"""A level of its own in every place: the sign, other fields, fine grids, slabs and threads, no seam at the lattice."""

from dataclasses import replace

import numpy as np
import pytest

from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.services.grid import Grid, cell_centers


@pytest.fixture(scope="module")
def leveled(free_tiling):
    control = np.log(free_tiling.solid_below) + np.random.default_rng(4).uniform(-0.3, 0.2, free_tiling.cells)
    field = LevelField(free_tiling, control)
    field.check()
    return field


def around(field, n, fraction=0.37):
    """Samples of the middle of the lattice that do not divide the cells."""
    h = 1 / n
    return Grid((fraction, 0.21, 0.1), (h, 1.1 * h, 0.9 * h), (n, n - 3, n // 2))


def test_solid_is_where_the_sum_is_below_the_spline(leveled, spline_values):
    grid = around(leveled, 30)
    level = np.exp(spline_values(leveled.control, *(grid.axis(a) for a in range(3)))).T
    sums = leveled.base.sums(grid)
    values = leveled.sample(grid)
    clear = np.abs(sums - level) > 1e-5
    assert ((values < 0) == (sums < level))[clear].all()
    assert np.array_equal(leveled.solid(grid), values < 0)
    assert 0.1 < values[values < 0].size / values.size < 0.9
    assert leveled.sum_level == pytest.approx(np.exp(leveled.control.mean()))
    assert values.min() >= -leveled.sum_level * (1 + 1e-6)


def test_layers_and_threads_do_not_matter(leveled):
    for n in (24, 100):  # summed, and interpolated
        grid = around(leveled, n)
        whole = leveled.solid_zyx(grid, 0, grid.shape[2])
        cut = grid.shape[2] // 3
        fresh = replace(leveled)
        slabs = np.concatenate([fresh.solid_zyx(grid, 0, cut, 2), fresh.solid_zyx(grid, cut, grid.shape[2], 2)])
        assert np.array_equal(whole, slabs)


def test_fine_grids_are_interpolated_from_finer_ones_where_tunnels_are_narrow(leveled):
    grid, narrow = around(leveled, 140), replace(leveled, control=leveled.control * 0.7)
    for field in (leveled, narrow):
        flips = np.count_nonzero(field.solid(grid) != field.exactly().solid(grid))
        assert 0 < flips <= 5e-5 * np.prod(grid.shape)
    assert narrow.coarse_pitch < leveled.coarse_pitch == leveled.base.coarse_pitch
    assert narrow.finest_radius < leveled.finest_radius < leveled.base.finest_radius


def test_patches_of_tiles_that_repeat_are_used(wang_tiling, spline_values):
    field = LevelField(wang_tiling, np.log(wang_tiling.solid_below) + np.linspace(-0.2, 0.1, 36).reshape(4, 3, 3))
    grid = cell_centers(16, (4, 3, 3))
    assert wang_tiling.patches(16, 0.5) is not None
    level = np.exp(spline_values(field.control, *(grid.axis(a) for a in range(3)))).T
    mean = field.solid_below
    assert np.abs(field.sample(grid) - (wang_tiling.sums(grid) * (mean / level) - mean)).max() < 1e-5
    assert np.array_equal(field.solid(grid), field.sample(grid) < 0)


def test_there_is_no_seam_at_the_planes_of_the_lattice(leveled):
    h = 1e-6
    for axis in range(3):
        if leveled.cells[axis] < 2:
            continue
        origin, spacing = [0.03, 0.02, 0.05], [0.083, 0.071, 0.077]
        origin[axis], spacing[axis] = 1 - h, 2 * h
        shape = [20, 20, 10]
        shape[axis] = 2
        values = leveled.sample(Grid(tuple(origin), tuple(spacing), tuple(shape)))
        assert np.abs(np.diff(values, axis=axis)).max() < 1e-3


class Waves(FormulaField):
    def evaluate(self, x, y, z):
        return np.cos(2 * np.pi * x) + np.cos(2 * np.pi * y) + np.cos(2 * np.pi * z)


def test_any_other_field_is_cut_at_the_spline(spline_values):
    waves = Waves(edge=3.0, region=(2, 1, 1))
    control = np.array([-0.5, 0.8]).reshape(2, 1, 1)
    field = LevelField(waves, control)
    field.check()
    grid = around(field, 20)
    level = spline_values(control, *(grid.axis(a) for a in range(3))).T
    assert np.allclose(field.sample(grid), waves.sample(grid) - level, atol=1e-6)
    assert np.array_equal(field.solid(grid), field.sample(grid) < 0)
    assert field.sum_level is None
    assert field.edge_mm == 3.0


def test_the_level_has_one_control_point_a_cell(leveled):
    with pytest.raises(ValueError, match="one finite control point for each cell"):
        replace(leveled, control=leveled.control[:1]).check()
