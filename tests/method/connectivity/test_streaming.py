"""Islands removed slab by slab equal islands removed from the whole array."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.connectivity import streaming
from sppm_pipeline.method.connectivity.components import find_components
from sppm_pipeline.method.connectivity.islands import keep_largest
from sppm_pipeline.method.connectivity.runs import find_runs
from sppm_pipeline.method.connectivity.streaming import IslandFilter
from sppm_pipeline.services.bit_rows import pack, unpack

BOX = (False, False, False)


class ByteFilter(IslandFilter):
    """The filter for layers as bytes."""

    def observe(self, slab):
        return super().observe(pack(slab))

    def clear(self, slab):
        bits = pack(slab)
        super().clear(bits)
        return slab * unpack(bits, slab.shape[2])


def cut(mask, sizes):
    k = 0
    while k < mask.shape[0]:
        n = sizes[k % len(sizes)]
        yield mask[k : k + n]
        k += n


def both_passes(mask, sizes):
    islands = ByteFilter(mask.shape[1], mask.shape[2])
    for slab in cut(mask, sizes):
        assert islands.observe(slab) == np.count_nonzero(slab)
    statistics = islands.finish()
    return np.concatenate([islands.clear(slab) for slab in cut(mask, sizes[::-1])]), statistics


def test_after_each_layer_the_largest_component_so_far_is_known():
    islands = ByteFilter(1, 9)
    for layer, main, others in (([1, 0, 1, 1, 0, 0, 0, 0, 0], 1, 1), ([0, 0, 0, 0, 0, 1, 1, 1, 1], 2, 0)):
        islands.observe(np.array([[layer]], np.uint8))
        assert islands._remembered[-1].main == main
        assert len(islands._remembered[-1].runs) == others


@settings(deadline=None, derandomize=True, max_examples=120)
@given(
    st.integers(0, 2**32 - 1),
    st.tuples(st.integers(1, 12), st.integers(1, 7), st.integers(1, 9)),
    st.floats(0.1, 0.9),
    st.lists(st.integers(1, 5), min_size=1, max_size=4),
)
def test_slabs_equal_the_whole_array(label, seed, shape, share, sizes):
    mask = (np.random.default_rng(seed).random(shape) < share).astype(np.uint8) * 255
    cleared, statistics = both_passes(mask, sizes)
    labels, voxels = label(mask, BOX, 6)
    np.testing.assert_array_equal(cleared, keep_largest(mask, BOX))
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
    cleared, statistics = both_passes(mask, [1])
    assert statistics.components == find_components(mask).sizes.size > 2000
    assert cleared.sum() == 90


def test_arms_that_meet_only_in_the_last_layer_are_one():
    mask = np.zeros((6, 5, 9), np.uint8)
    mask[:, 2, ::2] = 1
    mask[5, 2, :] = 1
    mask[0, 0, 0] = 1
    cleared, statistics = both_passes(mask, [2])
    assert statistics.components == 2
    assert statistics.spans == (True, False, True)
    assert cleared[:, 2].tolist() == mask[:, 2].tolist()
    assert not cleared[:, 0].any()


def test_an_empty_part():
    cleared, statistics = both_passes(np.zeros((3, 4, 5), np.uint8), [2])
    assert statistics == (3, 0, 0, 0.0, 0.0, (False, False, False))
    assert not cleared.any()


def test_a_second_pass_over_something_else_is_refused():
    mask = np.zeros((2, 3, 4), np.uint8)
    mask[:, 1, 1] = 1
    islands = ByteFilter(3, 4)
    islands.observe(mask)
    islands.finish()
    with pytest.raises(InputError, match="more layers"):
        islands.clear(np.concatenate([mask, mask]))
    other = mask.copy()
    other[0, 0, 3] = 1
    with pytest.raises(InputError, match="layer 0"):
        islands.clear(other)


@pytest.mark.parametrize("room", [0, 7, 60, 10_000])
@pytest.mark.parametrize("look", [0, 20, 10_000])
def test_loose_runs_that_are_written_down_change_nothing(monkeypatch, room, look):
    monkeypatch.setattr(streaming, "_MAX_STORED", room)
    monkeypatch.setattr(streaming, "_PRUNED_FROM", look)
    mask = np.random.default_rng(4).random((9, 6, 7)) < 0.3
    assert 60 < len(find_runs(mask).bounds) // 2 < 10_000
    cleared, _ = both_passes(mask.astype(np.uint8), [2, 1])
    assert np.array_equal(cleared != 0, keep_largest(mask, BOX))


def test_what_is_loose_below_the_largest_may_be_too_much_to_write_down(monkeypatch):
    monkeypatch.setattr(streaming, "_MAX_STORED", 100)
    mask = np.random.default_rng(1).random((12, 60, 60)) < 0.12
    mask[8:, 10:50, 10:50] = True  # numbered after thousands of others
    cleared, _ = both_passes(mask.astype(np.uint8), [5])
    assert np.array_equal(cleared != 0, keep_largest(mask, BOX))


def test_a_second_pass_over_fewer_runs_is_refused():
    mask = np.zeros((2, 3, 4), np.uint8)
    mask[:, 1, 1] = 1
    mask[1, 2, 3] = 1
    islands = ByteFilter(3, 4)
    islands.observe(mask)
    islands.finish()
    mask[1, 2, 3] = 0
    with pytest.raises(InputError, match="layer 1"):
        islands.clear(mask)


def test_what_grows_largest_last_is_kept_though_it_was_loose():
    mask = np.zeros((8, 6, 70), np.uint8)
    mask[:2, :3] = 1  # the largest for a while, and an island
    mask[:, 4, 66] = 1
    mask[4:, 3:] = 1
    mask[2, 0, 3] = 1
    cleared, statistics = both_passes(mask, [3])
    assert statistics.components == 2
    expected = mask.copy()
    expected[:3, :3] = 0
    assert np.array_equal(cleared, expected)


def test_loose_runs_of_a_column_are_dropped_once_it_has_joined(monkeypatch):
    monkeypatch.setattr(streaming, "_PRUNED_FROM", 50)
    mask = np.zeros((60, 5, 80), np.uint8)
    mask[:, 1, ::4] = 1
    mask[20, 1] = 1
    mask[:, 4, ::40] = 1  # two islands
    islands = ByteFilter(5, 80)
    written = []
    for layer in mask:
        islands.observe(layer[None])
        written.append(islands._written)
    assert max(written) > 300
    assert written[-1] <= 2 * 60 + 50
    islands.finish()
    mask[:, 4] = 0
    assert np.array_equal(islands.clear(mask | (np.arange(5) == 4)[:, None] * (np.arange(80) % 40 == 0)), mask)


def test_rows_with_few_runs_of_others():
    """Rows of many runs of one component, which are not compared with each other, and a few of others among them."""
    z, y, x = np.mgrid[:24, :70, :700]
    mask = np.sin(x / 2.1) + np.sin(y / 2.3) + np.sin((z + x / 9) / 2.7) > 0.3
    hollow = np.random.default_rng(12).integers((4, 8, 8), (20, 62, 690), (30, 3))
    for k, j, i in hollow:  # an island in a hollow, and one that hangs on a thread
        mask[k - 3 : k + 3, j - 5 : j + 6, i - 5 : i + 6] = False
        mask[k - 1 : k + 2, j - 3 : j + 3, i - 3 : i + 1] = True
        mask[k, j, i : i + 9] |= bool(i % 2)
    cleared, statistics = both_passes(mask.astype(np.uint8), [5])
    assert np.array_equal(cleared != 0, keep_largest(mask, BOX))
    found = find_components(mask, BOX)
    assert statistics.components == found.sizes.size > 8
    assert statistics.removed_share == pytest.approx(1 - found.sizes[0] / found.sizes.sum())
