"""The sum of all kernels without any cut-off, in float64: the truth that every faster way is held against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.kernels.kernels import Kernels

# Points times kernels of one chunk: 2^20 pairs keep the temporary arrays near 50 MB.
_PAIRS = 1 << 20


def exact_sum(kernels: Kernels, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of all kernels at arbitrary points (paper, eq. 1-3).

    Parameters
    ----------
    kernels : Kernels
        Pores and tunnels; a tunnel of length zero is a point.
    points : (k, 3) float64
        Sample points, in the unit of the kernels.

    Returns
    -------
    (k,) float64
        The field at the points.
    """
    points = np.asarray(points, dtype=np.float64)
    field = np.zeros(len(points))
    step = max(1, _PAIRS // max(1, len(kernels.centers), len(kernels.starts)))
    along = kernels.ends - kernels.starts
    squared_length = np.einsum("ij,ij->i", along, along)
    inverse = np.divide(1.0, squared_length, out=np.zeros_like(squared_length), where=squared_length > 0.0)
    for first in range(0, len(points), step):
        chunk = points[first : first + step, None, :]
        from_center = chunk - kernels.centers
        total = np.exp(-kernels.omega * np.einsum("ijk,ijk->ij", from_center, from_center)).sum(axis=1)
        from_start = chunk - kernels.starts
        share = np.clip(np.einsum("ijk,jk->ij", from_start, along) * inverse, 0.0, 1.0)
        nearest = from_start - share[..., None] * along
        distance = np.einsum("ijk,ijk->ij", nearest, nearest)
        if not kernels.squared:
            np.sqrt(distance, out=distance)
        field[first : first + step] = total + np.exp(-kernels.mu * distance).sum(axis=1)
    return field
