"""Sample elimination: exactly n points, taken away in the order of the slow, obvious loop, and better spread."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.capacity import min_spacing
from sppm_pipeline.method.sampling.elimination import eliminate, elimination_order


def slow_weights(points: np.ndarray, periodic: bool, ideal: float, nearest: float) -> np.ndarray:
    """Weight of each point, summed anew; Yuksel 2015, section 3."""
    gap = np.abs(points[:, None] - points[None])
    if periodic:
        gap = np.minimum(gap, 1.0 - gap)
    distance = np.maximum(np.sqrt((gap**2).sum(axis=-1)), nearest)
    weight = np.maximum(0.0, 1.0 - distance / ideal) ** 8
    np.fill_diagonal(weight, 0.0)
    return weight.sum(axis=1)


@settings(deadline=None, derandomize=True, max_examples=25)
@given(count=st.integers(1, 50), periodic=st.booleans(), flat=st.booleans(), seed=st.integers(0, 2**32))
def test_the_most_crowded_point_goes_first(count: int, periodic: bool, flat: bool, seed: int) -> None:
    upper = np.array([1.0, 1.0, 0.0 if flat else 1.0])
    points = np.random.default_rng(seed).random((3 * count, 3)) * upper
    order = elimination_order(points, count, [0] * 3, upper, (periodic,) * 3)
    assert sorted(order) == list(range(3 * count))
    ideal = math.sqrt(2 / math.sqrt(3) / count) if flat else (math.sqrt(2) / count) ** (1 / 3)
    nearest = ideal * 0.65 * (1.0 - (1 / 3) ** 1.5)
    for left in range(3 * count, count, -1):
        # The last of the rows still there is the next one taken away. Equal weights (a lone pair) may go either way.
        weights = slow_weights(points[order[:left]], periodic, ideal, nearest)
        assert weights[-1] >= weights.max() - 1e-12


@pytest.mark.parametrize("periodic", [False, True])
def test_far_better_spread_than_random_points(periodic: bool) -> None:
    count, wraps = 200, (periodic,) * 3
    for seed in range(5):
        points = eliminate(np.random.default_rng(seed), count, [0] * 3, [1] * 3, periodic=wraps)
        densest = (math.sqrt(2) / count) ** (1 / 3)
        assert 0.6 * densest < min_spacing(points, wraps) < densest
        random = np.random.default_rng(seed).random((count, 3))
        assert min_spacing(points, wraps) > 2 * min_spacing(random, wraps)


def test_box_line_and_point() -> None:
    rng = np.random.default_rng(0)
    box = eliminate(rng, 30, [0.2, 0.1, 0.3], [0.8, 0.4, 0.9])
    assert np.all((box >= [0.2, 0.1, 0.3]) & (box <= [0.8, 0.4, 0.9]))
    line = eliminate(rng, 10, [0.0, 0.5, 0.5], [1.0, 0.5, 0.5], periodic=(True, False, False))
    assert np.all(line[:, 1:] == 0.5)
    assert min_spacing(line, (True, False, False)) > 0.05
    np.testing.assert_array_equal(eliminate(rng, 2, [0.5] * 3, [0.5] * 3), np.full((2, 3), 0.5))


def test_edges_of_the_count() -> None:
    rng = np.random.default_rng(0)
    assert eliminate(rng, 0, [0] * 3, [1] * 3).shape == (0, 3)
    assert eliminate(rng, 7, [0] * 3, [1] * 3, oversampling=1.0).shape == (7, 3)


def test_same_seed_same_bytes() -> None:
    first, second = (eliminate(np.random.default_rng(9), 80, [0] * 3, [1] * 3).tobytes() for _ in range(2))
    assert first == second


def test_refusals() -> None:
    with pytest.raises(DesignError, match="count"):
        eliminate(np.random.default_rng(0), -1, [0] * 3, [1] * 3)
    with pytest.raises(DesignError, match="oversampling"):
        eliminate(np.random.default_rng(0), 5, [0] * 3, [1] * 3, oversampling=0.5)
