"""Slabs of layers decided by threads at once are those of the plain loop."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.fields.level_field import LevelField
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.method.stages.slice_field import SliceField
from sppm_pipeline.method.stages.tile_fresh import FreshTiling
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.plain_context import PlainContext
from tests.conftest import small_recipe


def test_threads_change_no_layer_of_a_part(ball, monkeypatch):
    monkeypatch.setattr("sppm_pipeline.method.slicing.sampled_slices.SLAB_PIXELS", 2**17)
    tiling = FreshTiling(cell=Length(5, "mm")).run(PlainContext(8), small_recipe(), ball)
    part = Part(tiling, ball)
    stack = SliceField(pixel=Length(0.07, "mm"), exact=True).run(PlainContext(), part)
    assert part.base.exactly().slabs_in_threads(stack.samples)
    assert stack.source.slabs_in_threads(stack.samples)
    once = stack.to_array()
    assert 0.01 < (once > 0).mean() < 0.9
    again = SliceField(pixel=Length(0.07, "mm"), exact=True).run(PlainContext(), part)
    np.testing.assert_array_equal(again.to_array(threads=3), once)


def test_interpolated_and_placed_layers_come_one_slab_after_the_other(wang_tiling, free_tiling):
    grid = SliceField(resolution=120).run(PlainContext(), free_tiling).samples
    assert not free_tiling.slabs_in_threads(grid)
    assert not wang_tiling.slabs_in_threads(SliceField(resolution=16).run(PlainContext(), wang_tiling).samples)


def test_signs_at_a_level_of_place_are_those_of_the_sum():
    tiling = FreshTiling(cells=(2, 2, 1), cell=Length(4, "mm")).run(PlainContext(8), small_recipe(), None).exactly()
    control = np.log(0.25) + np.random.default_rng(3).uniform(-0.35, 0.35, (2, 2, 1))
    field, grid = LevelField(tiling, control), Grid((0.203, -0.05, 0.4), (0.0115, 0.0125, 0.0115), (155, 120, 33))
    assert field.slabs_in_threads(grid)
    solid = field.solid_zyx(grid, 0, 33)
    sums = field._summed(grid, 0, 33, 1, None)
    changed = (solid != 0) != (sums < field.solid_below)
    assert 0.05 < solid.mean() < 0.95
    assert changed.mean() < 5e-5
    assert np.abs(sums - field.solid_below)[changed].max(initial=0) < 4e-4
    assert ((solid != 0) != (field.base.solid_zyx(grid, 0, 33) != 0)).mean() > 1e-3  # the level does matter
    parts = [field.solid_zyx(grid, k, min(k + 5, 33), 2) for k in range(0, 33, 5)]
    np.testing.assert_array_equal(np.concatenate(parts), solid)


def test_a_level_that_changes_too_fast_is_left_to_the_sums():
    tiling = FreshTiling(cells=(2, 1, 1), cell=Length(4, "mm")).run(PlainContext(8), small_recipe(), None).exactly()
    grid = Grid((0.0, 0.0, 0.0), (0.0115,) * 3, (40, 30, 9))
    assert tiling.slabs_in_threads(grid)
    steep = LevelField(tiling, np.log([[[0.01]], [[0.9]]]))
    assert not steep.slabs_in_threads(grid)
    solid = steep.solid_zyx(grid, 0, 9)
    np.testing.assert_array_equal(solid != 0, steep._summed(grid, 0, 9, 1, None) < steep.solid_below)


def test_signs_of_a_cell_repeat_with_it(cell):
    one, two = cell_centers(110), cell_centers(110, (2, 1, 1))
    exact = cell.exactly()
    assert exact.sign_sampler(two) is not None
    solid = exact.solid_zyx(two, 3, 12)
    sums = exact._summed(one, 3, 12, 1, None)
    assert ((solid[:, :, :110] != 0) != (sums < exact.solid_below)).mean() < 5e-5
    np.testing.assert_array_equal(solid[:, :, 110:], solid[:, :, :110])
    np.testing.assert_array_equal(exact.solid_zyx(one, 3, 12), solid[:, :, :110])


@pytest.mark.parametrize("rows", [1, 64, 65])
def test_a_band_of_one_row_is_one(rows):
    tiling = FreshTiling(cells=(1, 1, 1), cell=Length(4, "mm")).run(PlainContext(8), small_recipe(), None).exactly()
    grid = Grid((0.0, 0.0, 0.0), (0.0115,) * 3, (70, rows, 10))
    field = LevelField(tiling, np.full((1, 1, 1), np.log(0.25)))
    np.testing.assert_array_equal(field.solid(grid, threads=2), field.solid(grid))
