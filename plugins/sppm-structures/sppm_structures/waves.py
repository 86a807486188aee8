"""Sums of cosine waves with integer wave vectors: smooth random functions that repeat with the cell.

``f(p) = sum_i a_i cos(2 pi k_i . p + phase_i)`` is summed axis by axis: all waves that share (kx, ky) first along z,
then those that share kx along y, then along x. So a sample costs as many terms as there are different kx, some ten for
a thousand waves. Every sum runs in the order of the waves, whatever the grid.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import kernel

__all__ = ["Waves", "half_space", "sum_of_waves", "waves_of"]


class Waves(NamedTuple):
    """Waves sorted by wave vector, kx first.

    Attributes
    ----------
    vectors : (n, 3) int64
        Periods along the cell edges; of a vector and its opposite, which make the same wave, one.
    real, imaginary : (n,) float64
        ``a cos(phase)`` and ``a sin(phase)``.
    """

    vectors: NDArray[np.int64]
    real: NDArray[np.float64]
    imaginary: NDArray[np.float64]


def waves_of(vectors: NDArray[np.int64], phases: NDArray[np.float64], amplitudes: NDArray[np.float64] | float) -> Waves:
    """Sort waves for `sum_of_waves`; vectors (n, 3), phases (n,) in radians."""
    order = np.lexsort(np.asarray(vectors).T[::-1])
    amplitudes = np.broadcast_to(np.asarray(amplitudes, np.float64), len(vectors))[order]
    return Waves(
        np.ascontiguousarray(vectors[order], np.int64),
        amplitudes * np.cos(phases[order]),
        amplitudes * np.sin(phases[order]),
    )


def half_space(vectors: NDArray[np.int64]) -> NDArray[np.int64]:
    """Of every wave vector and its opposite the one that points up, or right, or ahead; without zero."""
    x, y, z = vectors.T
    kept: NDArray[np.int64] = vectors[(x > 0) | ((x == 0) & (y > 0)) | ((x == 0) & (y == 0) & (z > 0))]
    return kept


def sum_of_waves(
    waves: Waves, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The sum at the points of three axes (nx,), (ny,), (nz,), cell edges: (nz, ny, nx)."""
    values = np.zeros((len(z), len(y), len(x)))
    _sum(waves.vectors, waves.real, waves.imaginary, x.reshape(-1), y.reshape(-1), z.reshape(-1), values)
    return values


@kernel
def _sum(
    vectors: NDArray[np.int64],
    real: NDArray[np.float64],
    imaginary: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    turn = 2.0 * np.pi
    n = len(vectors)
    # where a new kx begins, and a new (kx, ky)
    columns, rows = np.empty(n + 1, np.int64), np.empty(n + 1, np.int64)
    row_of_column = np.empty(n + 1, np.int64)
    some_columns, some_rows = 0, 0
    for i in range(n):
        if i == 0 or vectors[i, 0] != vectors[i - 1, 0]:
            columns[some_columns] = i
            row_of_column[some_columns] = some_rows
            some_columns += 1
        if i == 0 or vectors[i, 0] != vectors[i - 1, 0] or vectors[i, 1] != vectors[i - 1, 1]:
            rows[some_rows] = i
            some_rows += 1
    rows[some_rows] = n
    row_of_column[some_columns] = some_rows
    cosines, sines = np.empty((some_columns, len(x))), np.empty((some_columns, len(x)))
    for c in range(some_columns):
        for i in range(len(x)):
            angle = turn * (vectors[columns[c], 0] * x[i])
            cosines[c, i], sines[c, i] = np.cos(angle), np.sin(angle)
    along_y = np.empty((len(y), some_rows, 2))
    for j in range(len(y)):
        for r in range(some_rows):
            angle = turn * (vectors[rows[r], 1] * y[j])
            along_y[j, r, 0], along_y[j, r, 1] = np.cos(angle), np.sin(angle)
    at_z = np.empty((some_rows, 2))
    for k in range(len(z)):
        for r in range(some_rows):
            re, im = 0.0, 0.0
            for i in range(rows[r], rows[r + 1]):
                angle = turn * (vectors[i, 2] * z[k])
                c, s = np.cos(angle), np.sin(angle)
                re += real[i] * c - imaginary[i] * s
                im += real[i] * s + imaginary[i] * c
            at_z[r, 0], at_z[r, 1] = re, im
        for j in range(len(y)):
            for c in range(some_columns):
                re, im = 0.0, 0.0
                for r in range(row_of_column[c], row_of_column[c + 1]):
                    re += at_z[r, 0] * along_y[j, r, 0] - at_z[r, 1] * along_y[j, r, 1]
                    im += at_z[r, 0] * along_y[j, r, 1] + at_z[r, 1] * along_y[j, r, 0]
                for i in range(len(x)):
                    values[k, j, i] += re * cosines[c, i] - im * sines[c, i]
