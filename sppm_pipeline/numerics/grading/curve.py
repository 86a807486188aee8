"""Porosity of a material as a function of the number of pores of a cell, measured on trial cells."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError


class PorosityCurve(NamedTuple):
    """Means of trial cells, interpolated monotonically (PCHIP: Fritsch and Carlson 1980).

    Attributes
    ----------
    counts : (m,) float64
        Numbers of pores of a cell, ascending.
    porosities : (m,) float64
        Their mean porosities, ascending.
    deviation : float
        Standard deviation of the porosity of single cells of one number of pores; 0 if there was one of each.
    """

    counts: NDArray[np.float64]
    porosities: NDArray[np.float64]
    deviation: float

    def pores(self, porosity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Numbers of pores, not whole, at porosities within the range of the curve."""
        from scipy.interpolate import PchipInterpolator

        found: NDArray[np.float64] = PchipInterpolator(self.porosities, self.counts)(porosity)
        return found

    def slope(self, counts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Porosity that one more pore adds; beyond the ends of the curve as at them."""
        from scipy.interpolate import PchipInterpolator

        within = np.clip(counts, self.counts[0], self.counts[-1])
        found: NDArray[np.float64] = PchipInterpolator(self.counts, self.porosities).derivative()(within)
        # PCHIP is level at a turning point and may be nearly so at an end
        mean = (self.porosities[-1] - self.porosities[0]) / (self.counts[-1] - self.counts[0])
        return np.asarray(np.maximum(found, 0.2 * mean))


def porosity_curve(counts: list[int], porosities: list[float]) -> PorosityCurve:
    """The curve through the means of equal counts.

    Raises
    ------
    DesignError
        If the porosity does not grow with the number of pores.
    """
    n, value = np.array(counts), np.array(porosities)
    order = np.unique(n)
    means = np.array([value[n == c].mean() for c in order])
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
