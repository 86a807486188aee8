import math

import numpy as np
import pytest

from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, empty_kernels
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum


def obvious_sum(kernels: Kernels, point: np.ndarray) -> float:
    total = sum(
        math.exp(-omega * math.dist(point, center) ** 2)
        for center, omega in zip(kernels.centers, kernels.omega, strict=True)
    )
    for a, b, mu in zip(kernels.starts, kernels.ends, kernels.mu, strict=True):
        along = b - a
        t = min(max(float((point - a) @ along) / float(along @ along), 0.0), 1.0) if along.any() else 0.0
        d = math.dist(point, a + t * along)
        total += math.exp(-mu * (d * d if kernels.profile == "squared" else d))
    return total


@pytest.mark.parametrize("profile", ["linear", "squared"])
def test_against_a_loop(profile: str) -> None:
    rng = np.random.default_rng(3)
    starts = rng.random((9, 3))
    ends = rng.random((9, 3))
    ends[4] = starts[4]
    kernels = Kernels(rng.random((7, 3)), rng.uniform(5, 90, 7), starts, ends, rng.uniform(5, 90, 9), profile)
    points = rng.random((40, 3)) * 1.4 - 0.2
    assert exact_sum(kernels, points) == pytest.approx([obvious_sum(kernels, p) for p in points])


def test_values_known_by_hand() -> None:
    kernels = Kernels(
        np.array([[0.0, 0.0, 0.0]]),
        np.array([2.0]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([[3.0, 0.0, 0.0]]),
        np.array([0.5]),
        "linear",
    )
    field = exact_sum(kernels, np.array([[2.0, 1.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    expected = [math.exp(-10.0) + math.exp(-0.5), 1.0 + math.exp(-0.5), math.exp(-50.0) + math.exp(-1.0)]
    assert field == pytest.approx(expected)


def test_many_points_in_chunks() -> None:
    rng = np.random.default_rng(0)
    points = rng.random((3000, 3))
    one = Kernels(rng.random((1, 3)), np.array([9.0]), rng.random((1, 3)), rng.random((1, 3)), np.array([7.0]))
    many = concatenated([one] * 600)
    assert exact_sum(many, points) == pytest.approx(600 * exact_sum(one, points))


def test_nothing() -> None:
    assert exact_sum(empty_kernels(), np.zeros((4, 3))).tolist() == [0.0] * 4
    assert exact_sum(empty_kernels(), np.zeros((0, 3))).shape == (0,)


def test_the_bound_shrinks_with_the_cutoff_and_with_blocks() -> None:
    rng = np.random.default_rng(7)
    starts = rng.random((20, 3)) * 3 - 1
    ends = starts + rng.normal(size=(20, 3)) * 0.2
    pores = rng.random((200, 3)) * 3 - 1
    kernels = Kernels(pores, rng.uniform(60.0, 300.0, 200), starts, ends, rng.uniform(30.0, 90.0, 20))
    bounds = [cutoff_bound(kernels, np.zeros(3), np.ones(3), cutoff) for cutoff in (1e-2, 1e-3, 1e-4)]
    assert bounds[0] > 3 * bounds[1] > 9 * bounds[2] > 0.0
    coarse, fine = (cutoff_bound(kernels, np.zeros(3), np.ones(3), 1e-3, blocks) for blocks in (2, 12))
    assert fine < coarse
    assert cutoff_bound(empty_kernels(), np.zeros(3), np.ones(3)) == 0.0
