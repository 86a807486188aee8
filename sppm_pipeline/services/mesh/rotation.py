"""Rotations of points: quarter turns are exact, and sums have one order."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64


def rotation(degrees: tuple[float, float, float]) -> F64:
    """The matrix (3, 3) of right-handed turns about x, then y, then z, degrees; quarter turns are exact."""
    total = np.eye(3)
    for axis, angle in enumerate(degrees):
        quarter = angle % 360
        exact = {0.0: (1.0, 0.0), 90.0: (0.0, 1.0), 180.0: (-1.0, 0.0), 270.0: (0.0, -1.0)}
        c, s = exact.get(quarter, (float(np.cos(np.radians(angle))), float(np.sin(np.radians(angle)))))
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        total = turn @ total
    return total


def upright(up: str) -> F64:
    """The rotation (3, 3) that turns the axis `up`, ``x``, ``y`` or ``z``, into z."""
    x, y, z = np.eye(3)
    return {"x": np.array([y, z, x]), "y": np.array([x, -z, y]), "z": np.eye(3)}[up]


def rotated(points: F64, matrix: F64) -> F64:
    """Points (n, 3) after a rotation (3, 3); BLAS, whose sums depend on its threads, is left out."""
    x, y, z = points.T
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in matrix], axis=1)
