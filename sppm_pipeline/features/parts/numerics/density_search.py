"""Densities that suit a load: the filter, sensitivities, and the update by optimality criteria.

Compliance is ``sum of w_l f_l . u_l`` over the load cases; at fixed loads its derivative by the density of an element
is ``-w_l u_l . (dK/d rho) u_l``, through the slope of the measured law. Design variables are averaged by a cone over
the part (Bruns and Tortorelli 2001) before they become densities, so that nothing is thinner than the cone:
homogenization needs densities that vary little over a cell, and patterns of single elements would be stiff by an error
of elements alone. Updates follow Bendsoe and Sigmund (2003), section 1.2.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

MOVE = 0.2
"""Largest change of a density in a step."""

HALVINGS = 60
"""Of the multiplier: to the last bit."""


class ConeFilter:
    """Means over the elements of a part, weighted by a cone.

    Parameters
    ----------
    solid : (nz, ny, nx) bool
    edges : (hx, hy, hz)
    radius : float
        Of the cone, in the unit of the edges; below an edge nothing is averaged.
    """

    def __init__(self, solid: NDArray[np.bool_], edges: tuple[float, float, float], radius: float) -> None:
        reach = [int(radius / h) for h in edges[::-1]]
        z, y, x = np.meshgrid(
            *(np.arange(-n, n + 1) * h for n, h in zip(reach, edges[::-1], strict=True)), indexing="ij"
        )
        self.kernel = np.maximum(radius - np.sqrt(x**2 + y**2 + z**2), 0.0)
        if not self.kernel.any():
            self.kernel = np.ones((1, 1, 1))
        self.solid = solid
        self.total = self._summed(np.ones(np.count_nonzero(solid)))

    def _summed(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        from scipy.ndimage import convolve

        grid = np.zeros(self.solid.shape)
        grid[self.solid] = values
        return np.asarray(convolve(grid, self.kernel, mode="constant")[self.solid])

    def mean(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Densities (m,) of design variables (m,)."""
        return self._summed(values) / self.total

    def back(self, slopes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives by design variables, from those by densities: the transpose, as the cone is symmetric."""
        return self._summed(slopes / self.total)


class Step(NamedTuple):
    """One step of a search."""

    design: NDArray[np.float64]
    change: float  # largest change of a design variable


def updated(
    design: NDArray[np.float64], gain: NDArray[np.float64], cost: NDArray[np.float64],
    bounds: tuple[NDArray[np.float64], NDArray[np.float64]], enough: Callable[[NDArray[np.float64]], bool],
) -> Step:  # fmt: skip
    """The next design: variables times the root of what they gain over what they cost, times a multiplier.

    Parameters
    ----------
    design : (m,)
    gain : (m,)
        By how much a unit of each lowers the compliance.
    cost : (m,)
        Mass of a unit of each.
    bounds : (m,), (m,)
    enough : callable
        Whether a design has at least the mass wanted, or is stiff enough; true of larger ones, too.
    """
    low, high = np.maximum(bounds[0], design - MOVE), np.minimum(bounds[1], design + MOVE)
    ratio = np.sqrt(np.maximum(gain, 0) / np.maximum(cost, 1e-300))
    scale = float(ratio.max()) or 1.0
    ratio /= scale
    least, most = 1e-6, 1e6
    for _ in range(HALVINGS):
        middle = float(np.sqrt(least * most))
        if enough(np.clip(design * ratio * middle, low, high)):
            most = middle
        else:
            least = middle
    made = np.clip(design * ratio * most, low, high)
    return Step(made, float(np.abs(made - design).max()))
