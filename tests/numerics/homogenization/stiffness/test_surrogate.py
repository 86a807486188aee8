"""The curve that proposes a parameter."""

import numpy as np
import pytest

from sppm_pipeline.numerics.homogenization.stiffness.surrogate import parameter_for


def test_an_exponential_is_met_at_once():
    x = np.array([0.8, 0.3, 0.5])
    guess, around = parameter_for(x, np.exp(-3 * x), float(np.exp(-3 * 0.42)))
    assert guess == pytest.approx(0.42, abs=1e-9)
    assert around == (0.3, 0.5)


def test_the_guess_stays_between_the_samples_that_enclose_the_target():
    x, y = np.array([0.0, 1, 2, 3]), np.array([1.0, 0.99, 0.01, 0.009])
    guess, (low, high) = parameter_for(x, y, 0.5)
    assert (low, high) == (1, 2)
    assert low < guess < high


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
