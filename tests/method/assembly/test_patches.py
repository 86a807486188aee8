import threading

import numpy as np
import pytest

from sppm_pipeline.method.assembly import patches
from sppm_pipeline.method.assembly.patches import build_bank, predicted_bytes


@pytest.mark.parametrize("level", [None, 0.25])
@pytest.mark.parametrize("merged", [False, True])
def test_prediction_is_an_upper_bound_and_not_a_wild_one(sets, merged: bool, level: float | None) -> None:
    pieces = sets.pieces(2)
    combinations = sets.combinations(sets.tiling(3, (2, 2, 2), pieces)) if merged else None
    for n in (12, 33):
        bank = build_bank(pieces, n, combinations, solid_level=level)
        assert bank.nbytes <= predicted_bytes(pieces, n, combinations, solid_level=level) < 6 * bank.nbytes


@pytest.mark.parametrize("level", [None, 0.25])
def test_rows_lie_one_after_the_other_and_begin_and_end_above_the_cut_off(sets, level) -> None:
    bank = build_bank(sets.pieces(3), 20, threads=3, solid_level=level)
    there = bank.row_blocks > 0
    length = 16 * bank.row_blocks[there].astype(np.int64)
    ends = np.cumsum(length)
    assert len(bank.low) > 2
    assert np.array_equal(bank.row_start[there], ends - length)
    assert ends[-1] == bank.data.size
    least = bank.cutoff * (1 if level is None else 32767 / level)
    assert all(bank.data[end - size : end].max() >= np.float32(least) for end, size in zip(ends, length, strict=True))


def test_threads_build_the_same_bank(sets) -> None:
    pieces = sets.pieces(4)
    one, two = build_bank(pieces, 20), build_bank(pieces, 20, threads=2)
    assert one.data.tobytes() == two.data.tobytes()
    assert one.row_start.tobytes() == two.row_start.tobytes()


def test_rows_are_trimmed_to_the_cutoff(sets) -> None:
    bank = build_bank(sets.pieces(5), 24, cutoff=1e-3)
    for start, blocks in zip(bank.row_start, bank.row_blocks, strict=True):
        if blocks:
            row = bank.data[start : start + 16 * blocks]
            assert row.max() >= 1e-3
    assert bank.data.size < bank.size.prod(axis=1).sum()


def test_a_patch_that_fails_leaves_no_other_waiting(sets, monkeypatch) -> None:
    second, raised = threading.Event(), []

    class Interrupted(patches._Ends):
        def take(self, number: int, length: int) -> int | None:
            if number == 0:
                second.wait(30)
                raise KeyboardInterrupt
            second.set()
            return super().take(number, length)

    def build() -> None:
        with pytest.raises(KeyboardInterrupt) as caught:
            build_bank(sets.pieces(4), 12, threads=2)
        raised.append(caught.value)

    monkeypatch.setattr(patches, "_Ends", Interrupted)
    builder = threading.Thread(target=build, daemon=True)  # a test that waits forever says nothing
    builder.start()
    builder.join(60)
    assert raised
