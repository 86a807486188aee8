"""Deviation from isotropy and anisotropy indices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from sppm_pipeline.services.elastic.isotropy import (
    averages,
    log_euclidean,
    nearest_isotropic,
    universal_anisotropy,
    zener,
)
from sppm_pipeline.services.elastic.voigt import isotropic, mandel, rotated
from tests.conftest import cubic


def random_stiffness(seed):
    rng = np.random.default_rng(seed)
    weight = np.array([1, 1, 1, *(2**0.5,) * 3])
    factor = rng.normal(size=(6, 9))
    return factor @ factor.T / np.outer(weight, weight)


TURN = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]


@given(young=st.floats(0.01, 100), poisson=st.floats(-0.9, 0.49))
@settings(max_examples=50, derandomize=True, deadline=None)
def test_an_isotropic_material_is_its_own_fit(young, poisson):
    stiffness = isotropic(young, poisson)
    for norm in ("paper", "tensor"):
        fit = nearest_isotropic(stiffness, norm)
        assert fit.young == pytest.approx(young)
        assert fit.poisson == pytest.approx(poisson, abs=1e-9)
        assert fit.relative == pytest.approx(0, abs=1e-12)
    assert universal_anisotropy(stiffness) == pytest.approx(0, abs=1e-9)
    assert log_euclidean(stiffness) == pytest.approx(0, abs=1e-6)
    assert zener(stiffness) == pytest.approx((1.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_the_papers_minimum_is_that_of_a_search(seed):
    """Nelder-Mead over E and nu finds nothing lower and the same place."""
    stiffness = random_stiffness(seed)
    fit = nearest_isotropic(stiffness)

    def distance(x):
        return np.linalg.norm(isotropic(x[0], np.clip(x[1], -0.999, 0.4999)) - stiffness) ** 2

    found = minimize(
        distance, (1.0, 0.1), method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-12, "maxiter": 4000}
    )
    assert fit.deviation == pytest.approx(found.fun, rel=1e-6)
    assert (fit.young, fit.poisson) == pytest.approx(tuple(found.x), rel=1e-3)


def test_the_tensor_norm_does_not_depend_on_the_frame_the_papers_does():
    stiffness = cubic(3.0, 1.0, 0.4)
    turned = rotated(stiffness, TURN)
    assert nearest_isotropic(turned, "tensor").deviation == pytest.approx(
        nearest_isotropic(stiffness, "tensor").deviation
    )
    assert abs(nearest_isotropic(turned).deviation / nearest_isotropic(stiffness).deviation - 1) > 0.01


def test_the_deviation_has_the_unit_of_stiffness_squared_the_relative_one_none():
    stiffness = random_stiffness(1)
    first, second = nearest_isotropic(stiffness), nearest_isotropic(10 * stiffness)
    assert second.deviation == pytest.approx(100 * first.deviation)
    assert second.relative == pytest.approx(first.relative)


def test_averages_of_a_cubic_crystal():
    """Closed forms of Hill for cubic symmetry; here copper, GPa."""
    c11, c12, c44 = 168.4, 121.4, 75.4
    mean = averages(cubic(c11, c12, c44))
    assert mean.bulk_voigt == pytest.approx((c11 + 2 * c12) / 3)
    assert mean.bulk_reuss == pytest.approx((c11 + 2 * c12) / 3)
    assert mean.shear_voigt == pytest.approx((c11 - c12 + 3 * c44) / 5)
    assert mean.shear_reuss == pytest.approx(5 * (c11 - c12) * c44 / (4 * c44 + 3 * (c11 - c12)))
    ratio, distance = zener(cubic(c11, c12, c44))
    assert ratio == pytest.approx(2 * c44 / (c11 - c12))
    assert distance == pytest.approx(0, abs=1e-12)
    # for cubic symmetry the index follows from the ratio alone
    assert universal_anisotropy(cubic(c11, c12, c44)) == pytest.approx(6 / 5 * (ratio**0.5 - ratio**-0.5) ** 2)


@given(seed=st.integers(0, 10**6))
@settings(max_examples=40, derandomize=True, deadline=None)
def test_indices_are_invariant_and_averages_ordered(seed):
    stiffness = random_stiffness(seed)
    turned = rotated(stiffness, TURN)
    mean = averages(stiffness)
    assert mean.bulk_reuss <= mean.bulk_voigt
    assert mean.shear_reuss <= mean.shear_voigt
    assert averages(turned) == pytest.approx(mean, rel=1e-8)
    assert universal_anisotropy(turned) == pytest.approx(universal_anisotropy(stiffness), rel=1e-7)
    assert universal_anisotropy(stiffness) >= 0


def test_a_structure_that_gives_way():
    bar = np.zeros((6, 6))
    bar[0, 0] = 1.0
    assert averages(bar)[1::2] == (0.0, 0.0)
    assert universal_anisotropy(bar) == np.inf
    assert log_euclidean(bar) == np.inf
    nothing = nearest_isotropic(np.zeros((6, 6)))
    assert nothing.young == 0
    assert np.isnan(nothing.poisson)
    assert nothing.deviation == 0


def test_rigid_under_pressure_only():
    """A fluid: bulk stiffness without shear stiffness."""
    fluid = np.zeros((6, 6))
    fluid[:3, :3] = 2.0
    mean = averages(fluid)
    assert mean.bulk_reuss == pytest.approx(2.0)
    assert mean.shear_reuss == 0
    assert np.linalg.matrix_rank(mandel(fluid)) == 1


@pytest.mark.parametrize("norm", ["paper", "tensor"])
def test_what_no_material_is_near_deviates_by_all_it_has(norm):
    """The square of its norm, as for the fit of a material."""
    stiffness = isotropic(3.0, 0.3)
    found = nearest_isotropic(-stiffness, norm)
    length = np.linalg.norm(stiffness if norm == "paper" else mandel(stiffness))
    assert (found.young, found.relative) == (0.0, 1.0)
    assert found.deviation == pytest.approx(length**2)
    assert nearest_isotropic(0 * stiffness, norm).deviation == 0
