"""The level spline along rows of samples, compiled: taken off a number, and compared with the samples of a cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

OUTSIDE = np.iinfo(np.int16).min
"""Code of samples that do not count."""


@jit
def less_level(
    rows: NDArray[np.float32],
    cell: NDArray[np.int64],
    weights: NDArray[np.float32],
    begin: np.float32,
    row: int,
    column: int,
    out: NDArray[np.float32],
) -> None:
    """A number less the spline in a window of a layer, (h, w) float32; products and sums one by one, as in NumPy.

    Parameters
    ----------
    rows : (ny, cells + 2) float32
        Control points along every row, with one more at each end.
    cell : (nx,) int64
        Cell of every sample of a row.
    weights : (3, nx) float32
        Of the control points before, in and after its cell.
    begin : float32
    row, column : int
        Where the window begins.
    out : (h, w) float32
    """
    height, width = out.shape
    i = 0
    while i < width:
        c, stop = cell[column + i], i + 1
        while stop < width and cell[column + stop] == c:
            stop += 1
        span = slice(column + i, column + stop)
        first, second, third = weights[0, span], weights[1, span], weights[2, span]
        for j in range(height):
            low, own, high = rows[row + j, c], rows[row + j, c + 1], rows[row + j, c + 2]
            target = out[j, i:stop]
            for k in range(stop - i):
                target[k] = begin - (low * first[k] + own * second[k] + high * third[k])
        i = stop


@jit
def counts_at_level(
    codes: NDArray[np.int16],
    rows: NDArray[np.float64],
    weights: NDArray[np.float64],
    middle: float,
    scale: float,
    most: float,
    width: int,
) -> tuple[int, int, int]:
    """Samples of a cell that count, those at or above the level, and those within a width of it.

    Parameters
    ----------
    codes : (n, n, n) int16
        Values less `middle`, times `scale`, rounded; `OUTSIDE` for those that do not count.
    rows : (n, n, 3) float64
        Control points of the spline before, in and after the cell along every row, indexed z, y.
    weights : (n, 3) float64
    middle, scale, most : float
        Levels are coded as values are, and no code is larger than `most`.
    width : int
    """
    inside, above, near = 0, 0, 0
    n = codes.shape[2]
    level = np.empty(n, np.int32)
    for z in range(codes.shape[0]):
        for y in range(codes.shape[1]):
            a, b, c = rows[z, y, 0], rows[z, y, 1], rows[z, y, 2]
            for x in range(n):
                value = a * weights[x, 0] + b * weights[x, 1] + c * weights[x, 2]
                level[x] = np.int32(np.rint(min(max((value - middle) * scale, -most), most)))
            for x in range(n):
                code = np.int32(codes[z, y, x])
                counted = code != OUTSIDE
                more = code - level[x]
                inside += counted
                above += counted and more >= 0
                near += counted and more >= -width and more < width
    return inside, above, near
