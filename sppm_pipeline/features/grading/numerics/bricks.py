"""Interpolation in samples of a cell or of layers, at points in any order."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import jit

BEFORE = 1
"""Samples that a brick holds before its first one; cubics need one there and two behind the last."""


@jit
def _weights(t: float, out: NDArray[np.float64]) -> None:
    out[0] = 0.5 * t * (-1.0 + t * (2.0 - t))
    out[1] = 1.0 + 0.5 * t * t * (-5.0 + 3.0 * t)
    out[2] = 0.5 * t * (1.0 + t * (4.0 - 3.0 * t))
    out[3] = 0.5 * t * t * (t - 1.0)


@jit
def interpolate(
    brick: NDArray[np.float32], places: NDArray[np.float64], chosen: NDArray[np.int64], out: NDArray[np.float32]
) -> None:
    """Values at places in a cell, by the four samples along each axis of Catmull and Rom (1974).

    `brick` (n + 4, n + 4, n + 4) are samples indexed x, y, z, n to an edge of the cell, the second one in its low
    corner; `places` (m, 3) are 0 to 1 in the cell, of which those `chosen` (k,) are written to `out` (m,).
    """
    n = brick.shape[0] - 4
    wx, wy, wz = np.empty(4), np.empty(4), np.empty(4)
    for m in chosen:
        x, y, z = places[m, 0] * n, places[m, 1] * n, places[m, 2] * n
        i, j, k = min(int(x), n), min(int(y), n), min(int(z), n)
        _weights(x - i, wx)
        _weights(y - j, wy)
        _weights(z - k, wz)
        total = 0.0
        for a in range(4):
            plane = 0.0
            for b in range(4):
                row = brick[i + a, j + b]
                plane += wy[b] * (wz[0] * row[k] + wz[1] * row[k + 1] + wz[2] * row[k + 2] + wz[3] * row[k + 3])
            total += wx[a] * plane
        out[m] = total


@jit
def cubic_in_layers(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Values (n,) at places (n, 3), x, y, z counted in samples from the first one, of layers indexed z, y, x; a place
    needs one sample before it and two behind it along each axis.
    """
    out = np.empty(len(places), np.float32)
    wx, wy, wz = np.empty(4), np.empty(4), np.empty(4)
    for m in range(len(places)):
        x, y, z = places[m, 0], places[m, 1], places[m, 2]
        i, j, k = int(np.floor(x)) - 1, int(np.floor(y)) - 1, int(np.floor(z)) - 1
        _weights(x - i - 1, wx)
        _weights(y - j - 1, wy)
        _weights(z - k - 1, wz)
        total = 0.0
        for c in range(4):
            plane = 0.0
            for b in range(4):
                row = values[k + c, j + b]
                plane += wy[b] * (wx[0] * row[i] + wx[1] * row[i + 1] + wx[2] * row[i + 2] + wx[3] * row[i + 3])
            total += wz[c] * plane
        out[m] = total
    return out


@jit
def linear_in_layers(values: NDArray[np.float32], places: NDArray[np.float64]) -> NDArray[np.float32]:
    """As `cubic_in_layers`, linear between samples."""
    out = np.empty(len(places), np.float32)
    for m in range(len(places)):
        x, y, z = places[m, 0], places[m, 1], places[m, 2]
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        x, y, z = x - i, y - j, z - k
        low = (1 - y) * ((1 - x) * values[k, j, i] + x * values[k, j, i + 1])
        low += y * ((1 - x) * values[k, j + 1, i] + x * values[k, j + 1, i + 1])
        high = (1 - y) * ((1 - x) * values[k + 1, j, i] + x * values[k + 1, j, i + 1])
        high += y * ((1 - x) * values[k + 1, j + 1, i] + x * values[k + 1, j + 1, i + 1])
        out[m] = (1 - z) * low + z * high
    return out
