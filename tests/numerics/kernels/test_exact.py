import math

import numpy as np
import pytest

from sppm_pipeline.numerics.kernels.exact import exact_sum
from sppm_pipeline.numerics.kernels.kernels import Kernels, concatenated, empty_kernels


def obvious_sum(kernels: Kernels, point: np.ndarray) -> float:
    total = sum(
        math.exp(-omega * math.dist(point, center) ** 2)
        for center, omega in zip(kernels.centers, kernels.omega, strict=True)
    )
    for a, b, mu in zip(kernels.starts, kernels.ends, kernels.mu, strict=True):
        along = b - a
        t = min(max(float((point - a) @ along) / float(along @ along), 0.0), 1.0) if along.any() else 0.0
        d = math.dist(point, a + t * along)
        total += math.exp(-mu * (d * d if kernels.squared else d))
    return total


@pytest.mark.parametrize("squared", [False, True])
def test_against_a_loop(squared: bool) -> None:
    rng = np.random.default_rng(3)
    starts = rng.random((9, 3))
    ends = rng.random((9, 3))
    ends[4] = starts[4]
    kernels = Kernels(rng.random((7, 3)), rng.uniform(5, 90, 7), starts, ends, rng.uniform(5, 90, 9), squared)
    points = rng.random((40, 3)) * 1.4 - 0.2
    assert exact_sum(kernels, points) == pytest.approx([obvious_sum(kernels, p) for p in points])


def test_values_known_by_hand() -> None:
    kernels = Kernels(
        np.array([[0.0, 0.0, 0.0]]),
        np.array([2.0]),
        np.array([[1.0, 0.0, 0.0]]),
        np.array([[3.0, 0.0, 0.0]]),
        np.array([0.5]),
        False,
    )
    field = exact_sum(kernels, np.array([[2.0, 1.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]]))
    expected = [math.exp(-10.0) + math.exp(-0.5), 1.0 + math.exp(-0.5), math.exp(-50.0) + math.exp(-1.0)]
    assert field == pytest.approx(expected)


def test_many_points_in_chunks() -> None:
    rng = np.random.default_rng(0)
    points = rng.random((3000, 3))
    one = Kernels(rng.random((1, 3)), np.array([9.0]), rng.random((1, 3)), rng.random((1, 3)), np.array([7.0]), False)
    many = concatenated([one] * 600)
    assert exact_sum(many, points) == pytest.approx(600 * exact_sum(one, points))


def test_nothing() -> None:
    assert exact_sum(empty_kernels(), np.zeros((4, 3))).tolist() == [0.0] * 4
    assert exact_sum(empty_kernels(), np.zeros((0, 3))).shape == (0,)


def test_two_tunnel_forms_do_not_mix() -> None:
    with pytest.raises(ValueError, match="one tunnel form"):
        concatenated([empty_kernels(True), empty_kernels(False)])
