"""Removing islands keeps the largest component, on the torus or in the box."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.connectivity.components import components_of_runs
from sppm_pipeline.method.connectivity.islands import keep_largest, loose_parts, negate_runs
from sppm_pipeline.method.connectivity.runs import find_runs


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.floats(0.1, 0.8), st.booleans())
def test_what_stays_is_label_one(label, seed, share, periodic):
    mask = (np.random.default_rng(seed).random((6, 7, 8)) < share).astype(np.uint8) * 200
    before = mask.copy()
    kept = keep_largest(mask, (periodic,) * 3)
    labels, _ = label(mask, (periodic,) * 3, 6)
    np.testing.assert_array_equal(kept, np.where(labels == 1, mask, 0))
    np.testing.assert_array_equal(mask, before)
    assert kept.dtype == np.uint8


def test_a_part_held_by_the_neighboring_cell_stays_only_on_the_torus():
    mask = np.zeros((4, 4, 8), bool)
    mask[1, 1, :5] = True
    mask[1, 1, 7] = True
    assert keep_largest(mask).sum() == 6
    assert keep_largest(mask, (False, True, True)).sum() == 5
    assert keep_largest(mask).dtype == np.bool_


def test_a_loose_part_counts_as_at_the_boundary_only_if_it_touches_it():
    mask = np.zeros((7, 7, 7), bool)
    mask[3, 3, 1:6] = True
    mask[1, 1, 1] = True
    assert loose_parts(mask) == (1, 0, 1 / 6)
    mask[6, 5, 5] = True
    assert loose_parts(mask) == (2, 1, 2 / 7)
    assert loose_parts(np.zeros((2, 2, 2), bool)) == (0, 0, 0.0)


def test_read_only_and_transposed_masks_are_taken():
    mask = np.zeros((4, 5, 6), np.uint8)
    mask[2, :, 3] = 1
    mask[0, 0, 0] = 1
    expected = keep_largest(mask)
    mask.setflags(write=False)
    np.testing.assert_array_equal(keep_largest(mask), expected)
    np.testing.assert_array_equal(keep_largest(np.asfortranarray(mask)), expected)


def test_signs_turn_in_the_runs_that_go_and_in_their_images():
    values = np.random.default_rng(6).standard_normal((5, 4, 9)).astype(np.float32)
    mask = (values < 0).view(np.uint8)
    found = components_of_runs(find_runs(mask), (True, True, True))
    around = np.pad(values, (0, 1), mode="wrap")
    for start, stop in ((0, 2), (2, 6)):
        slab = around[start:stop]
        negate_runs(found.runs.rows, found.runs.bounds, found.of_run == 0, mask.shape, start, slab)
    kept = keep_largest(mask)
    expected = np.where((mask == 1) & (kept == 0), -values, values)
    assert (kept != mask).any()
    assert np.array_equal(around, np.pad(expected, (0, 1), mode="wrap"))
