"""The inner loop of sums of waves, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import jit


@jit
def add_waves(
    vectors: NDArray[np.int64],
    real: NDArray[np.float64],
    imaginary: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    values: NDArray[np.float64],
) -> None:
    """Add waves, sorted by wave vector, to values (nz, ny, nx); see `waves.sum_of_waves`."""
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
