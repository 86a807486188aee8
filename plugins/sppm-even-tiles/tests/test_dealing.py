"""Dealing: the claims, counted cell by cell."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from sppm_even_tiles.dealing import Alike, alike_pairs, deal


def counted(interior: NDArray[np.int32]) -> Alike:
    """Every cell against every other one."""
    counts = [0, 0, 0]
    filled = [tuple(int(i) for i in place) for place in np.argwhere(interior >= 0)]
    for a, b in itertools.combinations(filled, 2):
        gaps = [abs(i - j) for i, j in zip(a, b, strict=True)]
        if max(gaps) == 1 and interior[a] == interior[b]:
            counts[sum(gaps) - 1] += 1
    return Alike(*counts)


def uses(interior: NDArray[np.int32], interiors: int) -> NDArray[np.int64]:
    return np.bincount(interior[interior >= 0], minlength=interiors)


@given(
    mask=arrays(np.bool_, st.tuples(*[st.integers(1, 5)] * 3)),
    interiors=st.integers(1, 30),
    seed=st.integers(0, 99),
)
@settings(deadline=None, derandomize=True, max_examples=80)
def test_equally_often_in_any_part_with_any_number_of_interiors(
    mask: NDArray[np.bool_], interiors: int, seed: int
) -> None:
    interior = deal(np.random.default_rng(seed), mask, interiors)
    assert interior.shape == mask.shape
    assert ((interior >= 0) == mask).all()
    assert interior.max() < interiors
    count = uses(interior, interiors)
    assert count.max() - count.min() <= 1
    found = counted(interior)
    assert alike_pairs(interior) == found
    if interiors >= 27:
        assert found == (0, 0, 0)


@pytest.mark.parametrize("shape", [(6, 6, 6), (9, 5, 7), (1, 20, 13)])
@pytest.mark.parametrize("interiors", [20, 27, 64])
def test_never_side_by_side(shape: tuple[int, int, int], interiors: int) -> None:
    for seed in range(5):
        interior = deal(np.random.default_rng(seed), np.ones(shape, bool), interiors)
        assert counted(interior) == (0, 0, 0)
        assert np.ptp(uses(interior, interiors)) <= 1


def test_with_few_interiors_equal_cells_touch_across_corners_rather_than_edges_rather_than_faces() -> None:
    eight = counted(deal(np.random.default_rng(0), np.ones((6, 6, 6), bool), 8))
    assert eight.face == 0
    assert eight.edge < eight.corner
    two = counted(deal(np.random.default_rng(0), np.ones((6, 6, 6), bool), 2))
    assert two.face == two.corner == 0  # a chequered pattern: no other one avoids all faces


def test_swaps_better_what_dealing_alone_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    mask = np.ones((6, 6, 6), bool)
    swapped = counted(deal(np.random.default_rng(1), mask, 12))
    monkeypatch.setattr("sppm_even_tiles.dealing._swap", lambda *_: None)
    assert sum(counted(deal(np.random.default_rng(1), mask, 12))) > 2 * sum(swapped)


def test_no_place_prefers_an_interior() -> None:
    # over many seeds each of 27 interiors comes equally often to each of 8 cells: 400 draws, 14.8 expected
    corners = np.stack([deal(np.random.default_rng(s), np.ones((2, 2, 2), bool), 27).ravel() for s in range(400)])
    for cell in corners.T:
        chi2 = ((np.bincount(cell, minlength=27) - 400 / 27) ** 2 / (400 / 27)).sum()
        assert chi2 < 60  # 26 degrees of freedom: beyond it with probability 2e-4
