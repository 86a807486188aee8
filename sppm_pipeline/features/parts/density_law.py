"""The law of a recipe over its density: all constants of its stiffness, and the onset of yield."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.parts.part_result import TOP
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.elastic.loaded import packed, unpacked
from sppm_pipeline.services.elastic.voigt import from_lame, lame
from sppm_pipeline.services.monotone_cubic import MonotoneCubic, monotone_cubic

SLACK = 0.02
"""Density by which a law is continued beyond its cells: cells of a number of pores scatter about as much."""

SHARES = (1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3)
"""Shares of the solid of trial cells whose onset of yield is measured, of which 0.1 % of a part's solid is made."""


class DensityLaw(NamedTuple):
    """All 21 constants of a stiffness over the relative density, each by monotone cubics, up to the solid.

    Attributes
    ----------
    density : (m,) float64
        Ascending; the last one is 1.
    constants : (21, m) float64
        In the unit of the solid's Young's modulus.
    onset : (s, m) float64 or None
        Mean stress, over the yield stress of the solid, at which each of `SHARES` of it yields.
    """

    density: F64
    constants: F64
    onset: F64 | None = None

    @property
    def _curves(self) -> list[MonotoneCubic]:
        return [monotone_cubic(self.density, one) for one in self.constants]

    def at(self, density: F64) -> F64:
        """Constants (21, n)."""
        return np.stack([curve.at(density) for curve in self._curves])

    def slope_at(self, density: F64) -> F64:
        """Derivatives of the constants (21, n)."""
        return np.stack([curve.slope_at(density) for curve in self._curves])

    def check_range(self, density: F64, what: str) -> None:
        """Raise `DesignError` if a density lies below those that were measured."""
        low = float(density.min())
        if low < self.density[0] - SLACK or float(density.max()) > 1:
            raise DesignError(
                f"{what} has relative densities from {low:.3g} to {float(density.max()):.3g}, and the law of the "
                f"recipe was measured from {self.density[0]:.3g} on",
                hint="give a wider range `density`, or bound the map of the porosity",
            )


def solid_constants(young: float, poisson: float) -> F64:
    """The 21 constants of an isotropic solid."""
    return packed(from_lame(*lame(young, poisson)))


def density_law(densities: F64, matrices: F64, young: float, poisson: float, *, cubic: bool) -> DensityLaw:
    """The law through the means of draws of densities (n, draws) and stiffnesses (n, draws, 6, 6).

    Parameters
    ----------
    young, poisson : float
        Of the solid, which ends the law.
    cubic : bool
        Average over the symmetries of a cube, which a structure without a preferred axis has in the mean.

    Raises
    ------
    DesignError
        If stiffness does not grow with density.
    """
    means = matrices.mean(axis=1)
    if cubic:
        means = np.stack([cubic_mean(one) for one in means])
    order = np.argsort(densities.mean(axis=1))
    x = np.append(densities.mean(axis=1)[order], 1.0)
    y = np.column_stack([packed(means[order]), solid_constants(young, poisson)])
    traces = y[[0, 6, 11, 15, 18, 20]].sum(axis=0)
    if len(x) < 3 or not (np.diff(traces) > 0).all():
        raise DesignError(
            "the stiffness of the trial cells does not grow with their density",
            hint="give more `trials`, a wider range `density`, or a finer `resolution`",
        )
    law = DensityLaw(x, y)
    if np.linalg.eigvalsh(unpacked(law.at(np.linspace(x[0], 1, 50))))[:, 0].min() <= 0:
        raise DesignError("a trial cell has no stiffness along some strain", hint="narrow the range `density`")
    return law


def cubic_mean(matrix: F64) -> F64:
    """Mean of a stiffness (6, 6) over the 48 symmetries of a cube: three constants are left."""
    normal, shear = matrix[:3, :3], matrix[3:, 3:]
    pairs = [normal[i, j] for i, j in itertools.combinations(range(3), 2)]
    found = np.zeros((6, 6))
    found[:3, :3] = np.mean(pairs)
    np.fill_diagonal(found, [np.trace(normal) / 3] * 3 + [np.trace(shear) / 3] * 3)
    return found


def yield_factor(stress: F64, onset: F64, solid: F64) -> float:
    """Factor on mean stresses (m,) by which as much of the solid of all elements reaches a stress of 1 as `TOP` leaves.

    `onset` (s, m) are the mean stresses at which `SHARES` of an element's solid do; `solid` (m,) is how much it has.
    """
    shares = np.log(SHARES)
    low, high = 1e-12, 1e12
    for _ in range(60):
        factor = float(np.sqrt(low * high))
        place = factor * stress / onset
        below = (place >= 1).sum(axis=0)
        k = np.clip(below, 1, len(SHARES) - 1)
        m = np.arange(len(stress))
        width = np.log(np.maximum(onset[k, m] / onset[k - 1, m], 1 + 1e-9))
        part = np.clip(np.log(np.maximum(place[k - 1, m], 1.0)) / width, 0, 1)
        yielded = np.where(below, np.exp(shares[k - 1] + part * (shares[k] - shares[k - 1])), 0)
        if yielded @ solid >= (1 - TOP / 100) * solid.sum():
            high = factor
        else:
            low = factor
    return high
