"""Islands removed slab by slab equal islands removed from the whole array."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.connectivity import streaming
from sppm_pipeline.numerics.connectivity.components import find_components
from sppm_pipeline.numerics.connectivity.islands import keep_largest
from sppm_pipeline.numerics.connectivity.runs import find_runs
from sppm_pipeline.numerics.connectivity.streaming import IslandFilter

BOX = (False, False, False)


def cut(mask, sizes):
    k = 0
    while k < mask.shape[0]:
        n = sizes[k % len(sizes)]
        yield mask[k : k + n]
        k += n


def both_passes(mask, sizes, connectivity, keep):
    islands = IslandFilter(mask.shape[1], mask.shape[2], connectivity)
    for slab in cut(mask, sizes):
        islands.observe(slab)
    statistics = islands.finish(keep)
    return np.concatenate([islands.clear(slab) for slab in cut(mask, sizes[::-1])]), statistics


@settings(deadline=None, derandomize=True, max_examples=120)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 12), st.integers(1, 7), st.integers(1, 9)),
    st.floats(0.1, 0.9),
    st.lists(st.integers(1, 5), min_size=1, max_size=4),
    st.sampled_from([6, 26]),
    st.sampled_from(["largest", 0.05, 0.3, 1.0]),
)
def test_slabs_equal_the_whole_array(label, seed, shape, share, sizes, connectivity, keep):
    mask = (np.random.default_rng(seed).random(shape) < share).astype(np.uint8) * 255
    cleared, statistics = both_passes(mask, sizes, connectivity, keep)
    labels, voxels = label(mask, BOX, connectivity)
    if keep == "largest":
        np.testing.assert_array_equal(cleared, keep_largest(mask, BOX, connectivity))
    else:
        stay = np.flatnonzero(voxels >= keep * voxels.sum()) + 1
        np.testing.assert_array_equal(cleared, np.where(np.isin(labels, stay) & (labels > 0), mask, 0))
    total = int(voxels.sum())
    assert statistics.layers == shape[0]
    assert statistics.voxels == total
    assert statistics.components == voxels.size
    assert statistics.removed_share == pytest.approx(1 - (cleared > 0).sum() / total if total else 0)
    if total:
        assert statistics.largest_share == voxels[0] / total
        everything, largest = np.argwhere(mask)[:, ::-1], np.argwhere(labels == 1)[:, ::-1]
        ends = (largest.min(axis=0) == everything.min(axis=0)) & (largest.max(axis=0) == everything.max(axis=0))
        assert statistics.spans == tuple(ends)


def test_more_ids_than_the_first_storage_holds():
    mask = np.zeros((3, 80, 90), np.uint8)
    mask[::2, ::2, ::2] = 1
    mask[0, 0, :] = 1
    cleared, statistics = both_passes(mask, [1], 6, "largest")
    assert statistics.components == find_components(mask).sizes.size > 2000
    assert cleared.sum() == 90


def test_arms_that_meet_only_in_the_last_layer_are_one():
    mask = np.zeros((6, 5, 9), np.uint8)
    mask[:, 2, ::2] = 1
    mask[5, 2, :] = 1
    mask[0, 0, 0] = 1
    cleared, statistics = both_passes(mask, [2], 6, "largest")
    assert statistics.components == 2
    assert statistics.spans == (True, False, True)
    assert cleared[:, 2].tolist() == mask[:, 2].tolist()
    assert not cleared[:, 0].any()


def test_clearing_in_place_returns_the_slab_itself():
    mask = np.zeros((2, 3, 4), np.uint8)
    mask[:, 1, 1] = 7
    mask[0, 0, 3] = 7
    islands = IslandFilter(3, 4)
    islands.observe(mask)
    islands.finish()
    assert islands.clear(mask, out=mask) is mask
    assert mask.sum() == 14


def test_an_empty_part():
    cleared, statistics = both_passes(np.zeros((3, 4, 5), np.uint8), [2], 6, "largest")
    assert statistics == (3, 0, 0, 0, 0.0, 0.0, (False, False, False))
    assert not cleared.any()


def test_a_second_pass_over_something_else_is_refused():
    mask = np.zeros((2, 3, 4), np.uint8)
    mask[:, 1, 1] = 1
    islands = IslandFilter(3, 4)
    islands.observe(mask)
    islands.finish()
    with pytest.raises(InputError, match="more layers"):
        islands.clear(np.concatenate([mask, mask]))
    other = mask.copy()
    other[0, 0, 3] = 1
    with pytest.raises(InputError, match="layer 0"):
        islands.clear(other)


def test_the_order_of_calls_is_checked():
    islands = IslandFilter(3, 4)
    layer = np.zeros((1, 3, 4), np.uint8)
    with pytest.raises(ValueError, match="after finish"):
        islands.clear(layer)
    with pytest.raises(ValueError, match="share"):
        islands.finish(0.0)
    with pytest.raises(ValueError, match="a slab is"):
        islands.observe(np.zeros((1, 4, 3), np.uint8))
    islands.finish()
    with pytest.raises(ValueError, match="before finish"):
        islands.observe(layer)
    with pytest.raises(ValueError, match="once"):
        islands.finish()


@pytest.mark.parametrize("room", [0, 7, 60, 10_000])
def test_ids_that_are_remembered_change_nothing(monkeypatch, room):
    monkeypatch.setattr(streaming, "_REMEMBERED", room)
    mask = np.random.default_rng(4).random((9, 6, 7)) < 0.3
    assert 60 < len(find_runs(mask).bounds) // 2 < 10_000
    for connectivity in (6, 26):
        cleared, _ = both_passes(mask.astype(np.uint8), [2, 1], connectivity, "largest")
        assert np.array_equal(cleared != 0, keep_largest(mask, BOX, connectivity))


def test_a_second_pass_over_fewer_runs_is_refused():
    mask = np.zeros((2, 3, 4), np.uint8)
    mask[:, 1, 1] = 1
    mask[1, 2, 3] = 1
    islands = IslandFilter(3, 4)
    islands.observe(mask)
    islands.finish()
    mask[1, 2, 3] = 0
    with pytest.raises(InputError, match="layer 1"):
        islands.clear(mask)
