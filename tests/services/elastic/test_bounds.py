"""Voigt, Reuss and Hashin-Shtrikman."""

import numpy as np
import pytest

from sppm_pipeline.services.elastic.bounds import Interval, bounds, hashin_shtrikman, reuss, voigt
from sppm_pipeline.services.elastic.voigt import isotropic

TWO = [(0.4, 10.0, 0.2), (0.6, 1.0, 0.35)]
POROUS = [(0.3, 1.0, 0.3), (0.7, 0.0, 0.0)]


def test_one_phase_is_its_own_bound():
    one = [(1.0, 2.0, 0.3)]
    assert np.allclose(voigt(one), isotropic(2.0, 0.3))
    assert np.allclose(reuss(one), isotropic(2.0, 0.3))
    bulk, shear = hashin_shtrikman(one)
    assert bulk == pytest.approx((2 / 1.2, 2 / 1.2))
    assert shear == pytest.approx((2 / 2.6, 2 / 2.6))


def test_two_phases_against_the_textbook():
    """The usual form for two well-ordered phases: K1 + f2 / (1/(K2-K1) + 3 f1/(3 K1+4 G1))."""
    (f2, e2, n2), (f1, e1, n1) = TWO
    k1, k2 = e1 / (3 - 6 * n1), e2 / (3 - 6 * n2)
    g1, g2 = e1 / (2 + 2 * n1), e2 / (2 + 2 * n2)
    lower_k = k1 + f2 / (1 / (k2 - k1) + 3 * f1 / (3 * k1 + 4 * g1))
    upper_k = k2 + f1 / (1 / (k1 - k2) + 3 * f2 / (3 * k2 + 4 * g2))
    lower_g = g1 + f2 / (1 / (g2 - g1) + 6 * f1 * (k1 + 2 * g1) / (5 * g1 * (3 * k1 + 4 * g1)))
    upper_g = g2 + f1 / (1 / (g1 - g2) + 6 * f2 * (k2 + 2 * g2) / (5 * g2 * (3 * k2 + 4 * g2)))
    bulk, shear = hashin_shtrikman(TWO)
    assert bulk == pytest.approx((lower_k, upper_k))
    assert shear == pytest.approx((lower_g, upper_g))


def test_void_takes_the_lower_bounds_to_zero():
    assert not reuss(POROUS).any()
    bulk, shear = hashin_shtrikman(POROUS)
    assert bulk.lower == shear.lower == 0
    k, g = 1 / 1.2, 1 / 2.6
    assert bulk.upper == pytest.approx(4 * g * k * 0.3 / (4 * g + 3 * k * 0.7))
    assert 0 < shear.upper < 0.3 * g


def test_youngs_modulus_follows_from_both_moduli():
    """9 K G / (3 K + G), at either end."""
    young = bounds(voigt(TWO), TWO).young
    for bound, k, g in zip(young, *hashin_shtrikman(TWO), strict=True):
        assert bound == pytest.approx(9 * k * g / (3 * k + g))
    assert bounds(voigt(POROUS), POROUS).young.lower == 0
    assert bounds(isotropic(2.0, 0.3), [(1.0, 2.0, 0.3)]).young == pytest.approx((2.0, 2.0))


def test_shares_of_zero_do_not_count():
    assert np.allclose(reuss([(1.0, 2.0, 0.3), (0.0, 0.0, 0.0)]), isotropic(2.0, 0.3))
    assert hashin_shtrikman([(1.0, 2.0, 0.3), (0.0, 0.0, 0.0)])[0].lower == pytest.approx(2 / 1.2)


def test_what_lies_outside_is_told():
    good = bounds(0.5 * (voigt(TWO) + reuss(TWO)), TWO)
    assert good.within
    assert not bounds(1.01 * voigt(TWO), TWO).within
    assert not bounds(0.99 * reuss(TWO), TWO).within
    stiff = bounds(voigt(TWO), TWO)
    assert stiff.within
    assert not stiff.bulk_holds
    assert not stiff.shear_holds


def test_a_laminate_is_within_voigt_and_reuss_but_its_shear_may_leave_hashin_shtrikman():
    """Layers across x: C11 is the harmonic mean of C11, C44 of yz the arithmetic mean."""
    stiff, soft = isotropic(1.0, 0.0), isotropic(0.01, 0.0)
    laminate = np.diag([2 / (1 / stiff[0, 0] + 1 / soft[0, 0]), 0.505, 0.505, 0.2525, 1 / (1 + 100), 1 / (1 + 100)])
    found = bounds(laminate, [(0.5, 1.0, 0.0), (0.5, 0.01, 0.0)])
    assert found.within


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e11])
def test_rounding_is_relative_to_the_bounds(unit):
    interval = Interval(unit, 2 * unit)
    assert interval.holds(2 * unit * (1 + 5e-10))
    assert interval.holds(unit * (1 - 5e-10))
    assert not interval.holds(2 * unit * (1 + 2e-9))
    assert not interval.holds(unit * (1 - 3e-9))
