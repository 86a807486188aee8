"""Signs decided by bounds: those of the sum at every sample, whatever is asked for with it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.assembly.gather import make_catalog, sample_exact
from sppm_pipeline.method.assembly.signs import SignSampler
from sppm_pipeline.method.kernels.kernels import Kernels, steepest
from sppm_pipeline.method.kernels.signs import (
    DROPPED,
    Levels,
    coarse_grid,
    crowd_of,
    decide_rows,
    find_bounds,
    one_level,
)
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.metric import stretched_metric
from sppm_pipeline.testing.exact_sum import exact_sum

CUTOFF = 1e-5
GRID = Grid((-0.013, 0.021, 0.007), (0.0101, 0.0113, 0.0127), (93, 85, 61))


def some_kernels(profile="linear", stretched=False, pores=40, tunnels=70):
    rng = np.random.default_rng(9)
    centers, starts = rng.random((pores, 3)), rng.random((tunnels, 3))
    ends = starts + rng.normal(0, 0.12, (tunnels, 3))
    mu = rng.uniform(33, 42, tunnels) if profile == "linear" else rng.uniform(70, 90, tunnels)
    metrics = (None, None)
    if stretched:
        metrics = tuple(stretched_metric(rng.uniform(0.95, 1.6, n), rng.normal(size=(n, 3))) for n in (pores, tunnels))
    return Kernels(centers, rng.uniform(60, 80, pores), starts, ends, mu, profile, *metrics)


def sampler_of(kernels, grid=GRID, level=0.25):
    none = tuple(np.full([1 + (a == axis) for a in range(3)], -1, np.int32) for axis in range(3))
    tiling = TilingArrays(np.zeros((1, 1, 1), np.int32), none, False)
    pieces = Pieces.of([kernels])
    bounds = find_bounds(*steepest(kernels), kernels.profile, one_level(level), grid.spacing, CUTOFF)
    assert bounds is not None
    catalog = make_catalog(pieces, CUTOFF)
    sums = sample_exact(pieces, tiling, grid, CUTOFF, catalog=catalog).T
    return SignSampler(catalog, tiling, grid, one_level(level), bounds.steps), sums


def exact_on(kernels, grid):
    z, y, x = np.meshgrid(*(grid.axis(axis) for axis in (2, 1, 0)), indexing="ij")
    return exact_sum(kernels, np.stack([x, y, z], -1).reshape(-1, 3)).reshape(x.shape)


KINDS = [("linear", False), ("squared", False), ("linear", True), ("squared", True)]


@pytest.mark.parametrize(("profile", "stretched"), KINDS)
@pytest.mark.parametrize("level", [0.06, 0.25, 0.6])
def test_signs_are_those_of_the_sum_but_at_the_level_itself(profile, stretched, level):
    sampler, sums = sampler_of(some_kernels(profile, stretched, pores=15, tunnels=25), level=level)
    solid = sampler.sample(0, GRID.shape[2], 1, None)
    changed = (solid != 0) != (sums < level)
    assert 0.05 < solid.mean() < 0.95
    assert np.abs(sums - level)[changed].max(initial=0) < 4e-4  # tails below the cut-off, of whatever kernels end there
    assert changed.mean() < 2e-4


@pytest.mark.parametrize(("profile", "stretched"), KINDS)
def test_bounds_hold_at_every_sample(profile, stretched):
    level, grid = 0.25, GRID._replace(shape=(51, 47, 38))
    nx, ny, nz = grid.shape
    kernels = some_kernels(profile, stretched)
    crowd = crowd_of(kernels.centers, 0.6)
    bounds = find_bounds(*steepest(kernels), profile, one_level(level), grid.spacing, CUTOFF, crowd)
    assert bounds is not None
    assert math.prod(bounds.steps) >= 4
    coarse = coarse_grid(grid, bounds.steps)
    above = exact_on(kernels, coarse).astype(np.float32)
    exact = exact_on(kernels, grid)
    out = np.zeros((nz, ny, nx), np.uint8)
    everything = np.tile(np.array([0, nx], np.int32), (nz, ny, 1))
    lists = np.empty(nz * ny + 1, np.int64), np.empty(out.size + 8, np.int32)
    decide_rows(above, 0, 0, *bounds[:3], 0, 0, ny, everything, out, *lists)
    assert (exact[out == 1] < level).all()
    assert (exact[out == 0] >= level).all()
    found = np.flatnonzero(out == 2)
    assert lists[0][-1] == len(found)
    np.testing.assert_array_equal(lists[1][: len(found)], found % nx)
    assert len(found) < 0.35 * out.size


@pytest.mark.parametrize(("profile", "stretched"), KINDS[:3])
def test_signs_depend_neither_on_slabs_nor_threads_nor_on_what_else_is_wanted(profile, stretched):
    nx, ny, nz = GRID.shape
    sampler, _ = sampler_of(some_kernels(profile, stretched))
    whole = sampler.sample(0, nz, 1, None)
    np.testing.assert_array_equal(sampler.sample(0, nz, 2, None), whole)
    for height in (1, 7, 25):
        parts = [sampler.sample(k, min(k + height, nz), 1, None) for k in range(0, nz, height)]
        np.testing.assert_array_equal(np.concatenate(parts), whole)
    ends = np.sort(np.random.default_rng(2).integers(0, nx + 1, (nz, ny, 2)), axis=2).astype(np.int32)
    ends[:, 30:40] = 0
    asked = (np.arange(nx) >= ends[..., :1]) & (np.arange(nx) < ends[..., 1:])
    np.testing.assert_array_equal(sampler.sample(0, nz, 1, ends), whole * asked)
    np.testing.assert_array_equal(sampler.sample(11, 31, 2, ends[11:31]), (whole * asked)[11:31])


def test_wide_grids_are_decided_in_bands(monkeypatch):
    monkeypatch.setattr("sppm_pipeline.method.assembly.signs._SITES", 1)
    monkeypatch.setattr("sppm_pipeline.method.assembly.signs._KEPT", 1)
    kernels = some_kernels()
    narrow, _ = sampler_of(kernels)
    assert narrow._rows < GRID.shape[1]
    monkeypatch.undo()
    wide, _ = sampler_of(kernels)
    assert wide._rows == GRID.shape[1]
    changed = narrow.sample(3, 40, 1, None) != wide.sample(3, 40, 1, None)
    assert changed.mean() < 1e-5  # bands are counted from origins of their own, which rounds otherwise


@pytest.mark.parametrize("pores", [0, 40])
@pytest.mark.parametrize("tunnels", [0, 70])
def test_any_kernels_will_do(pores, tunnels):
    kernels = some_kernels(pores=pores, tunnels=tunnels)
    if not pores and not tunnels:
        assert find_bounds(*steepest(kernels), "linear", one_level(0.25), GRID.spacing, CUTOFF) is None
        return
    sampler, sums = sampler_of(kernels)
    solid = sampler.sample(5, 9, 1, None)
    assert ((solid != 0) != (sums[5:9] < 0.25)).mean() < 1e-4


def test_coarse_grids_and_levels_of_no_surface_are_left_to_the_sums():
    for level, pitch in ((0.25, 0.04), (1.2, 0.01), (0.0, 0.01)):
        assert find_bounds(115.0, 46.0, "linear", one_level(level), (pitch,) * 3, CUTOFF) is None


def test_bounds_leave_open_what_kernels_that_were_dropped_could_change():
    """At coarse samples themselves nothing is interpolated; where the level drifts, its change to the next counts."""
    level, spacing = 0.25, (0.01, 0.01, 0.01)
    bounds = find_bounds(70.0, 40.0, "linear", one_level(level), spacing, CUTOFF)
    dropped = DROPPED * CUTOFF
    assert (bounds.solid[0], bounds.void[0]) == pytest.approx((level - dropped, level + dropped), rel=1e-6)
    drifting = find_bounds(70.0, 40.0, "linear", Levels(level, level, level, 1.5), spacing, CUTOFF)
    drift = 1.5 * sum(step * h for step, h in zip(bounds.steps, spacing, strict=True))
    assert drifting.steps == bounds.steps
    assert drift > 0.05
    np.testing.assert_allclose(drifting.solid, bounds.solid * math.exp(-drift), rtol=1e-6)
    np.testing.assert_allclose(drifting.void, bounds.void * math.exp(drift), rtol=1e-6)


def test_a_crowd_is_not_exceeded():
    points = np.random.default_rng(1).random((300, 3)) ** 2
    reach = 0.17
    within = (((points[:, None] - points[None]) ** 2).sum(-1) <= reach**2).sum(1).max()
    assert within <= crowd_of(points, reach) <= 300
    assert crowd_of(points[:0], reach) == 0
