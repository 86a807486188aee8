"""Targets are met by few evaluations of functions that are smooth, noisy, broken, or never get there."""

import math
from itertools import pairwise

import numpy as np
import pytest

from sppm_pipeline.services.target_search import parameter_for, relative_error, search


def one(function, target, *, low=0.0, high=1.0, accuracy=1e-3, **options):
    """A search for one target by one parameter."""
    return search(
        lambda at: function(*at) if function(*at) is None else (function(*at),),
        [low], [high], [target], accuracy, **({"first": 3, "evaluations": 30} | options),
    )  # fmt: skip


def two(function, targets, low, high, **options):
    """A search for two targets by two parameters."""
    return search(lambda at: function(*at), low, high, targets, 1e-3, first=3, **({"evaluations": 40} | options))


def permeability_and_modulus(porosity, radius):
    """Like those of tunnels in a solid: powers of both parameters."""
    return 1e-9 * porosity**4 / (1 - porosity) ** 2 * radius**2, (1 - porosity) ** 2 * (1 - radius)


def test_an_exponential_is_met_at_once():
    x = np.array([0.8, 0.3, 0.5])
    guess, around = parameter_for(x, np.exp(-3 * x), float(np.exp(-3 * 0.42)))
    assert guess == pytest.approx(0.42, abs=1e-9)
    assert around == (0.3, 0.5)
    # what is below 0 has logarithms as well, as long as all of it is
    assert parameter_for(x, -np.exp(-3 * x), -float(np.exp(-3 * 0.42)))[0] == pytest.approx(0.42, abs=1e-9)
    found = one(lambda x: math.exp(-5 * x), 0.1, accuracy=1e-9)
    assert found.met
    assert len(found.trials) == 4


def test_the_guess_stays_between_the_samples_that_enclose_the_target():
    x, y = np.array([0.0, 1, 2, 3]), np.array([1.0, 0.99, 0.01, 0.009])
    guess, (low, high) = parameter_for(x, y, 0.5)
    assert (low, high) == (1, 2)
    assert low < guess < high
    # zeros beyond have no logarithm, and do not spoil those within
    assert parameter_for(np.append(x, 4), np.append(y, 0.0), 0.5) == (guess, (low, high))


def test_a_target_on_a_sample_and_one_outside():
    x, y = np.array([0.0, 1]), np.array([2.0, 1.0])
    assert parameter_for(x, y, 2.0)[0] == pytest.approx(0, abs=1e-9)
    with pytest.raises(ValueError, match="outside"):
        parameter_for(x, y, 3.0)


def test_of_several_crossings_that_between_the_nearest_samples_is_taken():
    x, goal = np.array([0.0, 1, 2, 3]), 5.0
    moduli = goal * np.exp([2, -0.5, -0.1, 3])  # crossed between 0 and 1, and between 2 and 3
    guess, around = parameter_for(x, moduli, goal)
    assert around == (2, 3)
    assert 2 < guess < 2.5


@pytest.mark.parametrize(
    ("function", "target", "evaluations"),
    [
        (lambda x: x**3 - 0.2, 0.0, 9),  # a target 0, and a change of sign
        (lambda x: max(0.0, 0.5 - x) ** 3, 1e-5, 16),  # 0 in half of the range, as of pores that do not percolate
        (lambda x: 1 - (x - 0.37) ** 2, 0.9999, 10),  # met on both sides of an extreme between the first values
        (lambda x: x + 0.02 * math.sin(300 * x), 0.5, 12),  # noise of the parameter
        (lambda x: None if 0.4 < x < 0.6 else x, 0.65, 8),  # no number in the middle
    ],
)
def test_one_target_is_met(function, target, evaluations):
    found = one(function, target)
    assert found.met
    assert found.why == ""
    assert relative_error(found.best.numbers[0], target, 0.8) <= 1e-3
    assert found.best.numbers == (function(*found.best.at),)
    assert len(found.trials) <= evaluations
    assert len({trial.at for trial in found.trials}) == len(found.trials)


def test_what_is_out_of_reach_is_said_with_the_nearest():
    beyond = one(lambda x: math.exp(-x), 2.0)
    assert (beyond.met, beyond.why, beyond.best.at) == (False, "outside", (0.0,))
    assert len(beyond.trials) == 3
    peak = one(lambda x: 1 - (x - 0.37) ** 2, 1.2)
    assert (peak.met, peak.why) == (False, "outside")
    assert peak.best.at[0] == pytest.approx(0.37, abs=1 / 16)  # inside: looked for, and no bound stops it
    step = one(lambda x: 1.0 if x < 1 / 3 else 0.5, 0.7)
    assert (step.met, step.why) == (False, "jump")
    ends = sorted(trial.at[0] for trial in step.trials)
    assert min(b - a for a, b in pairwise(ends)) < 2e-4
    short = one(lambda x: x, 0.3, accuracy=1e-12, evaluations=3)
    assert (short.met, short.why, len(short.trials)) == (False, "exhausted", 3)
    with pytest.raises(ValueError, match="no trial"):
        one(lambda x: None, 1.0)


def test_integers_stay_integers():
    found = one(lambda x: x**2, 37.0**2, low=10, high=101, whole=[True])
    assert found.met
    assert found.best.at == (37.0,)
    assert all(trial.at[0].is_integer() for trial in found.trials)
    between = one(float, 30.5, low=10, high=100, whole=[True])
    assert between.why == "jump"
    assert {30.0, 31.0} <= {trial.at[0] for trial in between.trials}


@pytest.mark.parametrize("at", [(0.7, 0.05), (0.45, 0.021), (0.88, 0.079)])
def test_two_targets_are_met_by_two_parameters(at):
    targets = permeability_and_modulus(*at)
    found = two(permeability_and_modulus, targets, [0.4, 0.02], [0.9, 0.08])
    assert found.met
    assert found.best.numbers == pytest.approx(targets, rel=1e-3)
    assert len(found.trials) <= 16


def test_two_targets_with_zeros_signs_and_integers():
    found = two(lambda x, y: (x * y, x - y), (0.2, 0.0), [0, 0], [1, 1])
    assert found.met
    assert found.best.at == pytest.approx((0.2**0.5,) * 2, rel=2e-3)
    found = two(lambda x, y: (x * y, -x - y), (200.0, -33.0), [0, 0], [50, 50], whole=[True, False])
    assert found.met
    assert found.best.at[0] in (8.0, 25.0)


def test_two_targets_that_exclude_each_other():
    found = two(permeability_and_modulus, (1e-9, 0.5), [0.4, 0.02], [0.9, 0.08])
    assert (found.met, found.why) == (False, "outside")
    assert found.best.at[1] == pytest.approx(0.08)  # wider tunnels would help both
    found = two(lambda x, y: (x, x), (0.3, 0.6), [0, 0], [1, 1])
    assert not found.met
    # the best compromise of the relative errors of 0.3 and 0.6, to the accuracy of a stalled search
    assert max(abs(n / t - 1) for n, t in zip(found.best.numbers, (0.3, 0.6), strict=True)) < 0.5
