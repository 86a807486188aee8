"""The level is the quantile that gives the porosity, to half a sample."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.porosity.level import level_for_porosity


@settings(derandomize=True, deadline=None)
@given(
    st.integers(0, 2**32 - 1), st.integers(2, 400), st.floats(0.001, 0.999), st.sampled_from([np.float32, np.float64])
)
def test_porosity_is_met_within_one_sample(seed, n, target, dtype):
    samples = np.random.default_rng(seed).random(n).astype(dtype) + dtype(0.01)
    before = samples.copy()
    fit = level_for_porosity(samples, target)
    assert fit.porosity == np.mean(samples >= dtype(fit.level))
    assert abs(fit.porosity - target) <= 1 / n
    if 1 < target * n < n - 1:
        assert abs(fit.porosity - target) <= 0.5 / n + 1e-12
    np.testing.assert_array_equal(samples, before)


def test_the_level_lies_halfway_between_the_samples_it_parts():
    assert level_for_porosity(np.array([[1.0, 4.0], [2.0, 8.0]]), 0.5) == (3.0, 0.5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_neighboring_numbers_are_still_parted(dtype):
    low = dtype(0.25)
    fit = level_for_porosity(np.array([low, np.nextafter(low, dtype(1))], dtype), 0.5)
    assert fit.porosity == 0.5
    assert dtype(fit.level) == fit.level


def test_ties_are_reported_by_the_porosity_that_was_counted():
    assert level_for_porosity(np.array([0.1, 0.5, 0.5, 0.5, 0.9]), 0.4) == (0.5, 0.8)
    assert level_for_porosity(np.array([0.3]), 0.5) == (0.3, 1.0)


def test_a_porosity_beyond_the_reach_of_the_kernels_is_refused():
    samples = np.concatenate([np.zeros(60), np.linspace(0.1, 1, 40)])
    assert level_for_porosity(samples, 0.4).porosity == 0.4
    with pytest.raises(DesignError, match=r"up to 0\.4"):
        level_for_porosity(samples, 0.5)


@pytest.mark.parametrize("target", [0.0, 1.0, -0.2, 70.0, math.nan])
def test_a_target_that_is_no_porosity_is_refused(target):
    with pytest.raises(DesignError, match="can't be reached"):
        level_for_porosity(np.ones(5), target)


def test_samples_must_be_finite():
    with pytest.raises(ValueError, match="finite"):
        level_for_porosity(np.array([1.0, np.nan]), 0.5)
    with pytest.raises(ValueError, match="finite"):
        level_for_porosity(np.zeros(0), 0.5)
