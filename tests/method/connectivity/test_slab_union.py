"""Slabs that are labeled apart from each other, then united, equal one filter that goes through all layers."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.connectivity.slab_union import SlabUnion
from tests.method.connectivity.test_streaming import ByteFilter


def serial(mask):
    islands = ByteFilter(*mask.shape[1:])
    islands.observe(mask)
    statistics = islands.finish()
    return islands.clear(mask), statistics


def apart(mask, cuts):
    slabs = np.split(mask, cuts)
    union = SlabUnion()
    for slab in slabs:
        islands = ByteFilter(*mask.shape[1:])
        for k in range(0, len(slab), 2):  # in steps
            islands.observe(slab[k : k + 2])
        union.add(islands.labels())
    statistics, verdicts = union.finish()
    cleared = [
        ByteFilter.decided(*mask.shape[1:], len(slab), verdict).clear(slab)
        for slab, verdict in zip(slabs, verdicts, strict=True)
    ]
    return np.concatenate(cleared), statistics


@settings(deadline=None, derandomize=True, max_examples=80)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 12), st.integers(1, 8), st.integers(1, 70)),
    st.floats(0.05, 0.9),
    st.sets(st.integers(1, 11), max_size=6),
)
def test_cuts_change_neither_a_voxel_nor_a_number(seed, shape, share, cuts):
    mask = (np.random.default_rng(seed).random(shape) < share).astype(np.uint8)
    cleared, statistics = apart(mask, sorted(cut for cut in cuts if cut < shape[0]))
    expected, of_all = serial(mask)
    assert statistics == of_all
    assert np.array_equal(cleared, expected)


def test_the_first_of_equals_is_kept_wherever_it_is_cut():
    mask = np.zeros((6, 1, 9), np.uint8)
    mask[:3, 0, 6] = 1  # begins in the first layer, to the right
    mask[1:4, 0, 1] = 1  # as large, begins later
    mask[4:, 0, 3] = 1
    expected, of_all = serial(mask)
    assert expected[0, 0, 6] == 1
    for cut in range(1, 6):
        cleared, statistics = apart(mask, [cut])
        assert statistics == of_all
        assert np.array_equal(cleared, expected)


def test_a_part_that_is_one_through_other_slabs_only():
    """Two columns that a bridge far above joins, and a bridge far below."""
    mask = np.zeros((9, 1, 5), np.uint8)
    mask[:, 0, 0] = mask[:, 0, 4] = 1
    for bridge in (0, 8):
        joined = mask.copy()
        joined[bridge, 0, :] = 1
        cleared, statistics = apart(joined, range(1, 9))
        assert (statistics.components, statistics.removed_share, statistics.spans) == (1, 0.0, (True, True, True))
        assert np.array_equal(cleared, joined)


def test_other_layers_are_refused():
    islands = ByteFilter(2, 3)
    islands.observe(np.ones((1, 2, 3), np.uint8))
    union = SlabUnion()
    union.add(islands.labels())
    _, (verdict,) = union.finish()
    second = ByteFilter.decided(2, 3, 1, verdict)
    with pytest.raises(InputError, match="not that of the first"):
        second.clear(np.array([[[1, 0, 1], [0, 0, 0]]], np.uint8))
