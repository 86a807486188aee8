"""Bounds on the stiffness of a composite from its phases and their fractions alone."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.isotropy import averages
from sppm_pipeline.services.elastic.voigt import isotropic, mandel


class Interval(NamedTuple):
    """A modulus lies between `lower` and `upper`."""

    lower: float
    upper: float

    def holds(self, value: float, slack: float = 1e-9) -> bool:
        """True if `value` lies inside, up to rounding."""
        room = slack * max(abs(self.upper), abs(self.lower))
        return self.lower - room <= value <= self.upper + room


class Bounds(NamedTuple):
    """Bounds from the phases alone, and whether a computed stiffness satisfies them.

    Attributes
    ----------
    voigt, reuss : (6, 6)
        The stiffness lies between them, in the sense of energy, whatever its symmetry.
    within : bool
        Whether it does.
    bulk, shear : Interval
        Hashin-Shtrikman, for isotropic composites.
    bulk_holds, shear_holds : bool
        Whether the averages of Hill lie there; a structure that is far from isotropic need not.
    """

    voigt: F64
    reuss: F64
    within: bool
    bulk: Interval
    shear: Interval
    bulk_holds: bool
    shear_holds: bool

    @property
    def young(self) -> Interval:
        """Young's modulus of isotropic composites: it grows with both moduli, so that their bounds bound it."""
        low, high = (
            9 * bulk * shear / (3 * bulk + shear) if shear > 0 else 0.0
            for bulk, shear in zip(self.bulk, self.shear, strict=True)
        )
        return Interval(low, high)


def voigt(phases: list[tuple[float, float, float]]) -> F64:
    """Mean of the stiffnesses, (6, 6): the upper bound.

    Parameters
    ----------
    phases : list of (fraction, Young's modulus, Poisson's ratio)
        Fractions sum to 1; void has modulus 0.
    """
    total = np.zeros((6, 6))
    for fraction, young, poisson in phases:
        total += fraction * isotropic(young, poisson)
    return total


def reuss(phases: list[tuple[float, float, float]]) -> F64:
    """Inverse of the mean of the compliances, (6, 6): the lower bound; zero if there is void. See `voigt`."""
    if any(fraction > 0 and young == 0 for fraction, young, _ in phases):
        return np.zeros((6, 6))
    total = np.zeros((6, 6))
    for fraction, young, poisson in phases:
        if fraction > 0:
            total += fraction * np.linalg.inv(isotropic(young, poisson))
    return np.asarray(np.linalg.inv(total), np.float64)


def hashin_shtrikman(phases: list[tuple[float, float, float]]) -> tuple[Interval, Interval]:
    """Bounds on the bulk and the shear modulus of an isotropic composite of any number of phases. See `voigt`.

    References
    ----------
    Hashin and Shtrikman 1963; in the form of Berryman 1980, with the moduli of the softest and the stiffest phase.
    """
    present = [(f, e / (3 * (1 - 2 * nu)), e / (2 * (1 + nu))) for f, e, nu in phases if f > 0]
    bulks, shears = [bulk for _, bulk, _ in present], [shear for _, _, shear in present]

    def bulk(shear: float) -> float:
        return _shifted_mean([(fraction, k) for fraction, k, _ in present], 4 * shear / 3)

    # zeta(K, G) of Berryman
    def zeta(k: float, g: float) -> float:
        return g / 6 * (9 * k + 8 * g) / (k + 2 * g) if g > 0 else 0.0

    def shear(shift: float) -> float:
        return _shifted_mean([(fraction, g) for fraction, _, g in present], shift)

    return (
        Interval(bulk(min(shears)), bulk(max(shears))),
        Interval(shear(zeta(min(bulks), min(shears))), shear(zeta(max(bulks), max(shears)))),
    )


SLACK = 1e-6
"""Violations up to this part of the upper bound are rounding of the solver."""


def bounds(stiffness: F64, phases: list[tuple[float, float, float]]) -> Bounds:
    """All bounds, and whether `stiffness` keeps to them. See `voigt` for `phases`."""
    upper, lower = voigt(phases), reuss(phases)
    room = SLACK * float(np.linalg.norm(mandel(upper)))
    below = np.linalg.eigvalsh(mandel(upper - stiffness))[0] >= -room
    above = np.linalg.eigvalsh(mandel(stiffness - lower))[0] >= -room
    bulk, shear = hashin_shtrikman(phases)
    mean = averages(stiffness)
    return Bounds(
        upper,
        lower,
        bool(below and above),
        bulk,
        shear,
        bulk.holds(mean.bulk_hill, SLACK),
        shear.holds(mean.shear_hill, SLACK),
    )


def _shifted_mean(terms: list[tuple[float, float]], shift: float) -> float:
    """The harmonic mean of values to which `shift` was added, less `shift`."""
    if shift == 0 and any(value == 0 for _, value in terms):
        return 0.0
    return 1 / sum(fraction / (value + shift) for fraction, value in terms) - shift
