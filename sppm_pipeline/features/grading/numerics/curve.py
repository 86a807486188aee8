"""Curves of a material: porosity over the number of pores of a cell, Young's modulus over porosity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.monotone_cubic import monotone_cubic

GROUPS = 12
"""Maximum number of groups of cells of similar porosity, through whose means a curve of moduli goes. A heuristic: twice
as many follow the scatter of single cells, half as many smooth the curve."""


class PorosityCurve(NamedTuple):
    """Means of trial cells, interpolated monotonically (PCHIP: Fritsch and Carlson 1980)."""

    counts: F64  # (m,), numbers of pores of a cell, ascending
    porosities: F64  # (m,), their mean porosities, ascending
    deviation: float  # standard deviation of single cells of one number of pores; 0 if there was one of each

    def pores(self, porosity: F64) -> F64:
        """Numbers of pores, not whole, at porosities within the range of the curve."""
        return monotone_cubic(self.porosities, self.counts).at(np.asarray(porosity, np.float64))

    def slope(self, counts: F64) -> F64:
        """Porosity that one more pore adds; beyond the ends of the curve as at them."""
        within = np.clip(counts, self.counts[0], self.counts[-1])
        found = monotone_cubic(self.counts, self.porosities).slope_at(within)
        # PCHIP is level at a turning point and may be nearly so at an end
        mean = (self.porosities[-1] - self.porosities[0]) / (self.counts[-1] - self.counts[0])
        return np.asarray(np.maximum(found, 0.2 * mean))


def porosity_curve(counts: list[int], porosities: list[float]) -> PorosityCurve:
    """The curve through the means of equal counts; `DesignError` if porosity does not grow with the number of pores."""
    n, value = np.array(counts), np.array(porosities)
    order = np.unique(n)
    means = np.array([value[n == c].mean() for c in order])
    # means that fall behind an earlier one are scatter, and would fold the inverse
    growing = np.concatenate([[True], means[1:] > np.maximum.accumulate(means)[:-1]])
    if growing.sum() < 2:
        raise DesignError(
            f"the porosity does not grow with the number of pores: {means[0]:.3g} at {order[0]} pores a cell and "
            f"{means[-1]:.3g} at {order[-1]}",
            hint="give smaller radii, so that pores do not fill the cell",
        )
    left = value - means[np.searchsorted(order, n)]
    degrees = len(n) - len(order)
    deviation = float(np.sqrt((left**2).sum() / degrees)) if degrees else 0.0
    return PorosityCurve(order[growing].astype(np.float64), means[growing], deviation)


class StiffnessCurve(NamedTuple):
    """Young's modulus over porosity: its logarithm goes through means of cells by monotone cubics (PCHIP)."""

    porosities: F64  # (m,), ascending
    moduli: F64  # (m,), descending
    deviation: float  # relative standard deviation of single cells around the curve; 0 if it goes through all of them

    def porosity(self, modulus: F64) -> F64:
        """Porosities of moduli within the range of the curve; not a number beyond it."""
        log = np.log(self.moduli)
        # rounding may not put the ends of the range outside of it
        wanted = np.log(np.maximum(modulus, 1e-300))
        slack = 1e-9 * (1 + np.abs(log).max())
        inside = (wanted >= log[-1] - slack) & (wanted <= log[0] + slack)
        found = monotone_cubic(log[::-1], self.porosities[::-1]).at(np.clip(wanted, log[-1], log[0]))
        return np.where(inside, found, np.nan)

    def modulus(self, porosity: F64) -> F64:
        """Moduli at porosities, the inverse of `porosity`; not a number beyond the range of the curve."""
        log = np.log(self.moduli)
        curve = monotone_cubic(log[::-1], self.porosities[::-1]).at
        low, high = np.full(np.shape(porosity), log[-1]), np.full(np.shape(porosity), log[0])
        # bisection: the inverse of a monotone cubic, to the last bit after 60 halvings
        for _ in range(60):
            middle = (low + high) / 2
            above = curve(middle) > porosity
            low, high = np.where(above, middle, low), np.where(above, high, middle)
        inside = (porosity >= self.porosities[0]) & (porosity <= self.porosities[-1])
        return np.where(inside, np.exp((low + high) / 2), np.nan)


def stiffness_curve(porosities: F64, moduli: F64) -> StiffnessCurve:
    """The curve through cells, which may scatter: means of groups, made monotone by pooling neighbors that are not.

    Up to twelve cells stand for themselves, more are taken in twelve groups of nearly one porosity (pool-adjacent-
    violators: Barlow et al. 1972). `DesignError` if fewer than two different means remain.
    """
    order = np.argsort(porosities, kind="stable")
    x, y = porosities[order], np.log(moduli[order])
    groups = [g for g in np.array_split(np.arange(len(x)), min(GROUPS, len(x))) if len(g)]
    pooled: list[tuple[float, float, int]] = []
    for group in groups:
        pooled.append((float(x[group].mean()), float(y[group].mean()), len(group)))
        # pool adjacent violators: neighbors that rise or share a place become one weighted mean
        while len(pooled) > 1 and (pooled[-1][1] >= pooled[-2][1] or pooled[-1][0] <= pooled[-2][0]):
            (a, u, n), (b, v, m) = pooled[-2:]
            pooled[-2:] = [((n * a + m * b) / (n + m), (n * u + m * v) / (n + m), n + m)]
    if len(pooled) < 2:
        raise DesignError(
            "the modulus does not fall with the porosity",
            hint="give cells of a wider range of porosities, and more of them",
        )
    place, log = (np.array([row[k] for row in pooled]) for k in range(2))
    left = y - np.interp(x, place, log)
    between = (x >= place[0]) & (x <= place[-1])
    deviation = float(np.sqrt((left[between] ** 2).mean())) if len(x) > len(place) else 0.0
    return StiffnessCurve(place, np.exp(log), deviation)
