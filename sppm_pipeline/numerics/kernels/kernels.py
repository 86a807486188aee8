"""A set of pore and tunnel kernels as arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Kernels(NamedTuple):
    """Point kernels ``exp(-omega |p - c|^2)`` and segment kernels ``exp(-mu d)`` or ``exp(-mu d^2)`` (paper, eq. 1-2).

    ``d`` is the distance of p from the segment. All lengths are in one unit (inside a tile set: cell edges).

    Attributes
    ----------
    centers : (n, 3) float64
        Pore centers.
    omega : (n,) float64
        Pore size parameter, 1 / length^2.
    starts, ends : (m, 3) float64
        End points of the tunnels.
    mu : (m,) float64
        Tunnel size parameter, 1 / length, or 1 / length^2 for squared tunnels.
    squared : bool
        Whether the distance of the tunnels is squared. The paper prints the unsquared form.
    """

    centers: NDArray[np.float64]
    omega: NDArray[np.float64]
    starts: NDArray[np.float64]
    ends: NDArray[np.float64]
    mu: NDArray[np.float64]
    squared: bool

    def shifted(self, offset: NDArray[np.float64]) -> Kernels:
        """The same kernels moved by `offset` (3,)."""
        return self._replace(centers=self.centers + offset, starts=self.starts + offset, ends=self.ends + offset)


def empty_kernels(squared: bool = False) -> Kernels:
    """No kernel at all."""
    points, values = np.zeros((0, 3)), np.zeros(0)
    return Kernels(points, values, points, points, values, squared)


def concatenated(parts: Iterable[Kernels]) -> Kernels:
    """All kernels of several sets in order; the tunnel form must agree.

    Raises
    ------
    ValueError
        If the sets mix both tunnel forms.
    """
    parts = list(parts)
    if not parts:
        return empty_kernels()
    if len({part.squared for part in parts}) > 1:
        raise ValueError("a kernel set has one tunnel form")
    return Kernels(
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.omega for part in parts]),
        np.concatenate([part.starts for part in parts]),
        np.concatenate([part.ends for part in parts]),
        np.concatenate([part.mu for part in parts]),
        parts[0].squared,
    )
