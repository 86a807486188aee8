import numpy as np
import pytest

from sppm_pipeline.numerics.assembly.patches import build_bank, predicted_bytes, used_combinations
from sppm_pipeline.numerics.assembly.tiling_arrays import lone_periodic_cell


def test_used_combinations_are_what_a_loop_finds(sets) -> None:
    pieces = sets.pieces(0)
    tiling = sets.tiling(1, (4, 3, 5), pieces)
    expected = set()
    for i, j, k in np.ndindex(4, 3, 5):
        if tiling.interior[i, j, k] >= 0:
            x, y, z = tiling.faces
            colors = x[i, j, k], x[i + 1, j, k], y[i, j, k], y[i, j + 1, k], z[i, j, k], z[i, j, k + 1]
            expected.add((int(tiling.interior[i, j, k]), *map(int, colors)))
    found = used_combinations(tiling)
    assert [tuple(row) for row in found.tolist()] == sorted(expected)
    assert used_combinations(lone_periodic_cell(2, (0, 1, 0))).tolist() == [[2, 0, 0, 1, 1, 0, 0]]


@pytest.mark.parametrize("level", [None, 0.25])
@pytest.mark.parametrize("merged", [False, True])
def test_prediction_is_an_upper_bound_and_not_a_wild_one(sets, merged: bool, level: float | None) -> None:
    pieces = sets.pieces(2)
    combinations = used_combinations(sets.tiling(3, (2, 2, 2), pieces)) if merged else None
    for n in (12, 33):
        bank = build_bank(pieces, n, combinations, solid_level=level)
        assert bank.nbytes <= predicted_bytes(pieces, n, combinations, solid_level=level) < 6 * bank.nbytes


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


def test_bad_arguments(sets) -> None:
    with pytest.raises(ValueError, match="at least one voxel"):
        build_bank(sets.pieces(0), 0)
    with pytest.raises(ValueError, match="cut-off"):
        build_bank(sets.pieces(0), 8, cutoff=2.0)
