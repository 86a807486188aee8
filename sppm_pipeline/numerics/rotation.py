"""Rotations given by angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["rotation"]

_QUARTERS = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}


def rotation(degrees: tuple[float, float, float]) -> NDArray[np.float64]:
    """The matrix (3, 3) of a turn about x, then y, then z, counter-clockwise; quarter turns are exact."""
    total = np.eye(3)
    for axis, angle in enumerate(degrees):
        c, s = _QUARTERS.get(angle % 360, (float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))))
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        total = turn @ total
    return total
