"""Distances and local thickness: exact cases, and fast against obvious."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt

from sppm_pipeline.services.local_thickness import (
    UNREACHED,
    local_thickness,
    size_distribution,
    squared_distance,
)

BOX = (False, False, False)


def random_phase(seed, shape, share):
    return (np.random.default_rng(seed).random(shape) < share).astype(np.uint8)


@given(
    seed=st.integers(0, 10**6), share=st.floats(0.3, 0.99), wraps=st.tuples(st.booleans(), st.booleans(), st.booleans())
)
@settings(max_examples=40, derandomize=True, deadline=None)
def test_distances_are_those_of_scipy_on_repeated_copies(seed, share, wraps):
    phase = random_phase(seed, (5, 6, 7), share)
    phase[0, 0, 0] = 0
    copies = [3 if wrap else 1 for wrap in wraps[::-1]]
    middle = tuple(slice(n, 2 * n) if c == 3 else slice(0, n) for n, c in zip(phase.shape, copies, strict=True))
    expected = distance_transform_edt(np.tile(phase, copies))[middle] ** 2
    assert (squared_distance(phase, wraps) == np.round(expected)).all()


def test_nothing_outside_is_far():
    assert (squared_distance(np.ones((2, 3, 4), np.uint8)) == UNREACHED).all()
    assert (local_thickness(np.ones((2, 3, 4), np.uint8)) == 2).all()
    assert not local_thickness(np.zeros((2, 3, 4), np.uint8)).any()


def obvious(phase, periodic):
    """Every ball painted over everything it covers, the largest wins."""
    squared = squared_distance(phase, periodic)
    found = np.zeros(phase.shape)
    places = np.argwhere(squared > 0)
    for center in places:
        apart = np.abs(places - center)
        for axis in range(3):
            if periodic[2 - axis]:
                apart[:, axis] = np.minimum(apart[:, axis], phase.shape[axis] - apart[:, axis])
        reach = squared[tuple(center)]
        covered = places[(apart**2).sum(1) < reach]
        at = tuple(covered.T)
        found[at] = np.maximum(found[at], 2 * np.sqrt(reach) - 1)
    return found


@pytest.mark.parametrize("periodic", [(True, True, True), BOX, (True, False, False)])
@pytest.mark.parametrize("seed", range(4))
def test_painting_in_order_is_painting_everything(seed, periodic):
    smooth = np.random.default_rng(seed).normal(size=(9, 10, 11))
    for axis in range(3):
        smooth = smooth + np.roll(smooth, 1, axis) + np.roll(smooth, -1, axis)
    phase = (smooth > 0).astype(np.uint8)
    assert np.allclose(local_thickness(phase, periodic), obvious(phase, periodic), rtol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [1, 3, 7])
def test_a_plate_is_as_thick_as_it_is(axis, width):
    phase = np.zeros((16, 16, 16), np.uint8)
    index = [slice(None)] * 3
    index[axis] = slice(14, None)  # the plate lies across the seam
    phase[tuple(index)] = 1
    index[axis] = slice(0, max(0, width - 2))
    phase[tuple(index)] = 1
    if width < 2:
        phase = np.zeros_like(phase)
        index[axis] = slice(15, None)
        phase[tuple(index)] = 1
    found = local_thickness(phase)
    assert set(np.unique(found[phase > 0])) == {np.float32(width)}


def test_a_rod_and_a_ball():
    """The center lies on a voxel; the diameter is right to a voxel everywhere inside."""
    z, y, x = np.indices((31, 31, 31)) - 15
    rod = (x**2 + y**2 < 8.2**2).astype(np.uint8)
    ball = (x**2 + y**2 + z**2 < 11.3**2).astype(np.uint8)
    # at the rim the largest ball through a voxel of a stair is a smaller one; the bulk counts
    assert np.median(local_thickness(rod)[rod > 0]) == pytest.approx(16.4, abs=1)
    assert np.median(local_thickness(ball)[ball > 0]) == pytest.approx(22.6, abs=1)


def test_the_distribution_is_weighted_by_volume():
    thickness = np.array([0, 0, 1, 1, 1, 3], np.float32)
    found = size_distribution(thickness, 0.5)
    assert found.mean == pytest.approx(0.75)
    assert found.deviation == pytest.approx(np.std([0.5, 0.5, 0.5, 1.5]))
    assert (found.smallest, found.largest) == (0.5, 1.5)
    assert found.quantiles == (0.5, 0.5, 1.5)
    assert size_distribution(np.zeros(3, np.float32), 1.0) is None
