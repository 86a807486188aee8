"""Runs hold exactly the voxels of the mask, whatever its width."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sppm_pipeline.method.connectivity.runs import as_bytes, find_runs, neighbor_reach, stack_runs


def slow_runs(row):
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (row != 0).astype(np.int8), [0]])))
    return edges.tolist()


@settings(deadline=None, derandomize=True, max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.floats(0.02, 0.98), st.booleans())
def test_runs_are_the_changes_along_each_row(seed, nx, share, zeros):
    mask = (np.random.default_rng(seed).random((2, 3, nx)) < share).astype(np.uint8) * 255
    runs = find_runs(mask, zeros)
    phase = mask == 0 if zeros else mask != 0
    for row in range(6):
        bounds = runs.bounds[2 * runs.rows[row] : 2 * runs.rows[row + 1]]
        assert bounds.tolist() == slow_runs(phase[row // 3, row % 3])
    assert runs.lengths.sum() == phase.sum()


@pytest.mark.parametrize("nx", [1, 63, 64, 65, 128])
def test_alternating_voxels_fill_the_storage_to_the_brim(nx):
    mask = np.zeros((40, 50, nx), np.uint8)
    mask[..., ::2] = 1
    runs = find_runs(mask)
    assert runs.n_runs == 2000 * ((nx + 1) // 2)
    assert (runs.lengths == 1).all()


@given(hnp.arrays(np.bool_, (2, 3, 4)))
def test_bytes_of_any_layout_are_the_same_mask(mask):
    np.testing.assert_array_equal(as_bytes(mask.transpose(2, 1, 0)), mask.transpose(2, 1, 0))


def test_a_mask_of_another_type_is_refused():
    with pytest.raises(ValueError, match="bool or uint8"):
        as_bytes(np.zeros((2, 2, 2), np.int32))
    with pytest.raises(ValueError, match="nz, ny, nx"):
        as_bytes(np.zeros((2, 2), np.uint8))


def test_only_two_connectivities_exist():
    assert (neighbor_reach(6), neighbor_reach(26)) == (0, 1)
    with pytest.raises(ValueError, match="18"):
        neighbor_reach(18)


def test_runs_of_slabs_are_stacked_to_those_of_the_whole():
    mask = np.random.default_rng(5).integers(0, 2, (7, 4, 70)).astype(np.uint8)
    whole = find_runs(mask)
    stacked = stack_runs([find_runs(mask[:2]), find_runs(mask[2:2]), find_runs(mask[2:])])
    assert stacked.shape == whole.shape
    assert np.array_equal(stacked.rows, whole.rows)
    assert np.array_equal(stacked.bounds, whole.bounds)
    assert stacked.rows.dtype == whole.rows.dtype
