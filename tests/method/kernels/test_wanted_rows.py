"""Sums for parts of rows only: right where wanted, whatever happens beside."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import Grid


def some_kernels(profile):
    rng = np.random.default_rng(5)
    starts = rng.random((40, 3))
    ends = starts + rng.normal(0, 0.2, (40, 3))
    mu = np.full(40, 900.0 if profile == "squared" else 60.0)
    return Kernels(rng.random((30, 3)), np.full(30, 120.0), starts, ends, mu, profile)


@pytest.mark.parametrize("profile", ["linear", "squared"])
@pytest.mark.parametrize("nx", [64, 45])
def test_wanted_samples_are_those_of_the_whole_sum(profile, nx):
    grid = Grid((0.01, 0.02, 0.03), (1 / nx, 1 / 40, 1 / 20), (nx, 40, 20))
    kernels = some_kernels(profile)
    whole = np.zeros((20, 40, nx), np.float32)
    add_kernels(whole, grid, kernels)
    rng = np.random.default_rng(1)
    ends = np.sort(rng.integers(0, nx + 1, (20, 40, 2)), axis=2).astype(np.int32)
    part = np.zeros_like(whole)
    add_kernels(part, grid, kernels, wanted=ends)
    x = np.arange(nx)
    asked = (x >= ends[..., :1]) & (x < ends[..., 1:])
    assert asked.any()
    assert np.abs(part - whole)[asked].max() < 5e-5  # tails of kernels below the cut-off of 1e-5
    assert not np.array_equal(part, whole)


def test_parts_of_rows_depend_neither_on_threads_nor_on_slabs():
    grid = Grid((0.0, 0.0, 0.0), (1 / 64, 1 / 40, 1 / 20), (64, 40, 20))
    kernels = some_kernels("linear")
    ends = np.sort(np.random.default_rng(2).integers(0, 65, (20, 40, 2)), axis=2).astype(np.int32)
    once = np.zeros((20, 40, 64), np.float32)
    add_kernels(once, grid, kernels, wanted=ends)
    threads = np.zeros_like(once)
    add_kernels(threads, grid, kernels, threads=2, wanted=ends)
    np.testing.assert_array_equal(once, threads)
    slab = np.zeros((7, 40, 64), np.float32)
    add_kernels(slab, grid, kernels, first_layer=5, wanted=np.ascontiguousarray(ends[5:12]))
    x = np.arange(64)
    asked = (x >= ends[5:12, :, :1]) & (x < ends[5:12, :, 1:])
    np.testing.assert_array_equal(slab[asked], once[5:12][asked])


@pytest.mark.parametrize("number", [0, 1000, -1])
def test_a_single_sample_is_wanted(number):
    grid = Grid((0.01, 0.02, 0.03), (1 / 64, 1 / 40, 1 / 20), (64, 40, 20))
    whole, part = np.zeros((2, 20, 40, 64), np.float32)
    add_kernels(whole, grid, some_kernels("linear"))
    z, y, x = np.argwhere(whole > 0.1)[number]
    ends = np.zeros((20, 40, 2), np.int32)
    ends[z, y] = x, x + 1
    add_kernels(part, grid, some_kernels("linear"), wanted=ends)
    assert part[z, y, x] == pytest.approx(whole[z, y, x], abs=5e-5)
    assert np.count_nonzero(part.any(axis=2)) == 1
