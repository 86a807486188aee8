"""The search meets its target on smooth functions and staircases, within its bound of evaluations."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.porosity.level import search_monotone


class Counted:
    def __init__(self, function):
        self.function = function
        self.seen = []

    def __call__(self, x):
        self.seen.append(x)
        return self.function(x)


CURVES = [
    lambda x: x,
    lambda x: -(x**3),
    lambda x: math.exp(8 * x),
    lambda x: -math.tanh(40 * (x - 0.03)),
    lambda x: math.floor(500 * x) / 500,
]


@settings(derandomize=True)
@given(st.sampled_from(CURVES), st.floats(0.01, 0.99))
def test_a_monotone_function_is_solved(curve, share):
    low, high = curve(0.0), curve(1.0)
    target = low + share * (high - low)
    tolerance = 0.002 * abs(high - low)
    counted = Counted(curve)
    result = search_monotone(counted, 0.0, 1.0, target, tolerance, 40)
    assert result.met
    assert result.bracketed
    assert abs(curve(result.x) - target) <= tolerance
    assert result.value == pytest.approx(curve(result.x))
    assert result.evaluations == len(counted.seen) <= 2 + 3 * math.ceil(math.log2(500 * 40))
    assert all(0 <= x <= 1 for x in counted.seen)


def test_a_smooth_curve_takes_a_handful_of_evaluations():
    assert search_monotone(lambda d: 0.7 - 0.3 * d - 0.1 * d * d, 0.1, 0.4, 0.6, 1e-4).evaluations <= 5


@pytest.mark.parametrize("most", [2, 3, 7])
def test_the_best_so_far_comes_back_when_the_bound_is_reached(most):
    counted = Counted(lambda x: 1.0 if x > 1 / 3 else 0.0)
    result = search_monotone(counted, 0.0, 1.0, 0.4, 0.01, most)
    assert not result.met
    assert result.evaluations == len(counted.seen) == most
    assert result.value == 0.0


def test_a_step_is_closed_in_on_until_its_sides_are_neighbors():
    counted = Counted(lambda x: 1.0 if x > 1 / 3 else 0.0)
    result = search_monotone(counted, 0.0, 1.0, 0.4, 0.01, 1000)
    assert result.evaluations < 2 + 3 * 60
    assert not result.met
    assert result.x == pytest.approx(1 / 3) or result.x == 0.0
    assert max(x for x in counted.seen if x <= 1 / 3) == pytest.approx(1 / 3, abs=1e-15)


def test_a_target_outside_gives_the_better_end():
    result = search_monotone(lambda x: x, 2.0, 5.0, 7.0, 0.1)
    assert result == (5.0, 5.0, False, False, 2)
    assert search_monotone(lambda x: x, 2.0, 5.0, 1.0, 0.1).x == 2.0


def test_an_end_that_is_good_enough_costs_nothing_more():
    assert search_monotone(lambda x: x, 2.0, 5.0, 2.05, 0.1).evaluations == 1
    assert search_monotone(lambda x: x, 2.0, 5.0, 4.95, 0.1).evaluations == 2
