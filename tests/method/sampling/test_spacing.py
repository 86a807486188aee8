"""Measured distances against the slow, obvious way."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.sampling.capacity import min_spacing, nearest_distances


def slow_nearest(points: np.ndarray, periodic: tuple[bool, ...]) -> np.ndarray:
    shifts = np.array(list(itertools.product(*[(-1, 0, 1) if wraps else (0,) for wraps in periodic])), dtype=float)
    distances = np.linalg.norm(points[None, :, None] - (points[None] + shifts[:, None])[:, None], axis=-1)
    itself = int(np.flatnonzero(np.all(shifts == 0, axis=1))[0])
    distances[itself][np.diag_indices(len(points))] = math.inf
    return distances.min(axis=(0, 2))


@settings(deadline=None, derandomize=True, max_examples=80)
@given(
    count=st.integers(1, 40),
    periodic=st.tuples(st.booleans(), st.booleans(), st.booleans()),
    flat=st.sampled_from([(1, 1, 1), (0, 1, 1), (1, 0, 0), (0.2, 1, 0.1)]),
    seed=st.integers(0, 2**32),
)
def test_nearest_neighbors(count: int, periodic: tuple[bool, ...], flat: tuple[float, ...], seed: int) -> None:
    points = np.random.default_rng(seed).random((count, 3)) * flat
    slow = slow_nearest(points, periodic)
    np.testing.assert_allclose(nearest_distances(points, periodic), slow, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(min_spacing(points, periodic), slow.min(), rtol=1e-12, atol=1e-15)


def test_few_points() -> None:
    assert min_spacing(np.empty((0, 3))) == math.inf
    assert nearest_distances(np.empty((0, 3))).shape == (0,)
    assert min_spacing([[0.3, 0.3, 0.3]]) == 1.0
    assert min_spacing([[0.3, 0.3, 0.3]], (False, False, False)) == math.inf
    assert min_spacing([[0.1, 0.5, 0.5], [2.9, 0.5, 0.5]]) == pytest.approx(0.2)
    assert min_spacing([[0.5, 0.5, 0.5]] * 2) == 0.0
