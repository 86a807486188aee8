"""The line from pores to porosity against numpy's fit, and its inverse."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.porosity.line import PorosityLine, count_for_porosity, fit_line, predict_porosity

EXACT = fit_line([20, 60, 100], [0.2, 0.4, 0.6])


def test_points_on_a_line_give_the_line():
    assert EXACT.slope == pytest.approx(0.005)
    assert EXACT.intercept == pytest.approx(0.1)
    assert EXACT.r_squared == pytest.approx(1.0)
    assert EXACT.largest_residual == pytest.approx(0.0, abs=1e-12)
    assert (EXACT.n_min, EXACT.n_max, EXACT.samples) == (20, 100, 3)
    assert predict_porosity(EXACT, 30) == pytest.approx(0.25)


@settings(derandomize=True, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 60))
def test_fit_equals_numpys(seed, m):
    rng = np.random.default_rng(seed)
    n = rng.permutation(200)[:m]
    rho = 0.004 * n + 0.05 + rng.normal(0, 0.02, m)
    slope, intercept = np.polyfit(n, rho, 1)
    if slope <= 0:
        return
    line = fit_line(n, rho)
    residuals = rho - (slope * n + intercept)
    assert line.slope == pytest.approx(slope)
    assert line.intercept == pytest.approx(intercept, abs=1e-9)
    assert line.r_squared == pytest.approx(np.corrcoef(n, rho)[0, 1] ** 2, abs=1e-9)
    assert line.largest_residual == pytest.approx(np.abs(residuals).max())
    assert line.residual_sd == pytest.approx(np.sqrt((residuals**2).sum() / (m - 2)))


@given(st.integers(20, 100))
def test_the_inverse_gives_the_count_back(n):
    assert count_for_porosity(EXACT, predict_porosity(EXACT, n)) == n


def test_half_a_pore_beyond_the_range_is_clipped_and_more_refused():
    assert count_for_porosity(EXACT, 0.202) == 20
    assert count_for_porosity(EXACT, 0.198) == 20
    assert count_for_porosity(EXACT, 0.602) == 100
    for wish in (0.19, 0.61, float("nan")):
        with pytest.raises(DesignError, match=r"0\.2 to 0\.6 for 20 to 100 pores"):
            count_for_porosity(EXACT, wish)


def test_a_line_goes_through_json_unchanged():
    assert PorosityLine(**json.loads(json.dumps(EXACT._asdict()))) == EXACT


def test_samples_that_hold_no_line_are_refused():
    with pytest.raises(DesignError, match="two different"):
        fit_line([5, 5, 5], [0.1, 0.2, 0.3])
    with pytest.raises(DesignError, match="two different"):
        fit_line([5], [0.1])
    with pytest.raises(DesignError, match="does not grow"):
        fit_line([5, 6, 7], [0.3, 0.2, 0.1])


def test_two_samples_have_no_spread():
    assert fit_line([1, 3], [0.1, 0.2]).residual_sd == 0.0
