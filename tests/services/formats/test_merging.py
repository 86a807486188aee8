"""Equal rows are found whatever their number."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.services.formats.mesh_arrays import merge_equal


def obvious(rows: np.ndarray) -> tuple[list[int], list[int]]:
    seen: dict[bytes, int] = {}
    first, numbers = [], []
    for k, row in enumerate(rows):
        key = row.tobytes()
        if key not in seen:
            seen[key] = len(first)
            first.append(k)
        numbers.append(seen[key])
    return first, numbers


@settings(derandomize=True, deadline=None, max_examples=100)
@given(
    count=st.integers(0, 5000),
    different=st.integers(1, 40),
    seed=st.integers(0, 100),
    kind=st.sampled_from([np.float32, np.int32]),
)
def test_as_a_dictionary_finds_them(count: int, different: int, seed: int, kind: type) -> None:
    rows = np.random.default_rng(seed).integers(0, different, (count, 3)).astype(kind)
    first, numbers = merge_equal(rows)
    assert (first.tolist(), numbers.tolist()) == obvious(rows)


@pytest.mark.parametrize("count", [8 * 1024 - 1, 8 * 1024 + 1, 40_000])
def test_rows_that_all_differ_make_the_table_grow(count: int) -> None:
    rows = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    first, numbers = merge_equal(np.concatenate([rows, rows]))
    assert np.array_equal(first, np.arange(count))
    assert np.array_equal(numbers, np.tile(np.arange(count), 2))


def test_zeros_of_both_signs_differ() -> None:
    assert merge_equal(np.array([[0, 0, 0], [-0.0, 0, 0]], np.float32))[1].tolist() == [0, 1]
