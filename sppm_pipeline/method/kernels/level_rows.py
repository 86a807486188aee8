"""The level spline along rows of samples, compiled: taken off a number, and compared with the samples of a cell."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I16, I64
from sppm_pipeline.services.jit.compiled import jit

OUTSIDE = np.iinfo(np.int16).min
"""Code of samples that do not count."""


@jit
def less_level(rows: F32, cell: I64, weights: F32, begin: np.float32, row: int, column: int, out: F32) -> None:
    """A number less the spline in a window of a layer, (h, w) float32; products and sums one by one, as in NumPy.

    `rows` (ny, cells + 2) are the control points along every row, with one more at each end; `cell` (nx,) is the cell
    of every sample of a row, and `weights` (3, nx) those of the control points before, in and after it. The window
    begins at `row`, `column`.
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
def void_at_level(
    codes: I16, control: F64, weights: F64, middle: float, scale: float, most: float, width: int
) -> tuple[int, int, int, int]:
    """Samples of a cell that count, and their distance above the level, clipped to the width that the count resolves.

    `codes` (n, n, n) int16, indexed z, y, x, are values less `middle`, times `scale`, rounded, and `OUTSIDE` for those
    that do not count; levels are coded alike, up to `most`. `control` (3, 3, 3), indexed x, y, z, are control points in
    and around the cell, and `weights` (n, 3) those of the ones before, in and after it at the samples along an axis.
    `width` is a multiple of 4.

    Returns the number of samples that count; the sum of how far they lie above the level less half a width, at most a
    width; the same for half of it; and the number of those within half a width of the level.
    """
    inside, beside = int(np.int64(0)), int(np.int64(0))
    wide, narrow = int(np.int64(0)), int(np.int64(0))
    n = codes.shape[2]
    level = np.empty(n, np.int32)
    plane, row = np.empty((3, 3)), np.empty(3)
    half, quarter = np.int32(width // 2), np.int32(width // 4)
    for z in range(codes.shape[0]):
        for i in range(3):
            for j in range(3):
                c = control[i, j]
                plane[i, j] = c[0] * weights[z, 0] + c[1] * weights[z, 1] + c[2] * weights[z, 2]
        for y in range(codes.shape[1]):
            for i in range(3):
                p = plane[i]
                row[i] = p[0] * weights[y, 0] + p[1] * weights[y, 1] + p[2] * weights[y, 2]
            for x in range(n):
                value = row[0] * weights[x, 0] + row[1] * weights[x, 1] + row[2] * weights[x, 2]
                level[x] = np.int32(np.rint(min(max((value - middle) * scale, -most), most)))
            for x in range(n):
                code = np.int32(codes[z, y, x])
                counted = np.int32(code != OUTSIDE)
                more = code - level[x]
                inside += int(counted)
                wide += int(counted * min(max(more + half, np.int32(0)), half + half))
                narrow += int(counted * min(max(more + quarter, np.int32(0)), half))
                beside += int(counted * np.int32(more >= -half and more < half))
    return inside, wide, narrow, beside
