"""A quadratic tensor spline over a lattice of cells, with one control point in the middle of each.

Inside a cell, at t from 0 to 1 along an axis, the control points before, in and after it have the weights
``(1 - t)^2 / 2``, ``1/2 + t - t^2`` and ``t^2 / 2``: the uniform B-spline of degree two, whose value and slope are
continuous. Beyond the first and the last cell the outermost control point is repeated, so that the spline ends with
slope zero and goes on as a constant. Its mean over a cell is ``(1/6, 2/3, 1/6)`` of the three control points.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I16, I64, Bools
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


class _Along(NamedTuple):
    """Positions along one axis: the first and last cell that they lie in, and for each its cell and three weights."""

    cell: I64
    weights: F64


def _along(positions: F64, cells: int) -> _Along:
    cell = np.clip(np.floor(positions).astype(np.int64), 0, cells - 1)
    t = np.clip(positions - cell, 0.0, 1.0)
    return _Along(cell, np.stack([(1 - t) ** 2 / 2, 0.5 + t - t**2, t**2 / 2], -1))


def _contracted(values: F64, along: _Along) -> F64:
    """Control points along the first axis of `values` to positions along the last one of the result."""
    padded = np.concatenate([values[:1], values, values[-1:]])
    taken = [padded[along.cell + k] * along.weights[:, k].reshape(-1, *[1] * (values.ndim - 1)) for k in range(3)]
    return np.moveaxis(taken[0] + taken[1] + taken[2], 0, -1)


@cache
def weights_in_cell(n: int) -> F64:
    """Weights (n, 3) of the control points before, in and after a cell, in the middles of n voxels along an axis."""
    weights = _along(1 + (np.arange(n) + 0.5) / n, 3).weights
    weights.flags.writeable = False
    return weights


class LayerSpline:
    """The spline with `control` (nx, ny, nz) on the rows of layers, at samples x (k,), y (m,), z (n,) in cell sizes.

    A value depends on its position alone: it is the same sum of three numbers whatever is asked for beside it.
    """

    def __init__(self, control: F64, x: F64, y: F64, z: F64) -> None:
        across = _along(x, control.shape[0])
        self._cell, self._weights = across.cell, np.ascontiguousarray(across.weights.T, np.float32)
        upwards, along = _along(z, control.shape[2]), _along(y, control.shape[1])
        planes = _contracted(control.transpose(2, 0, 1), upwards)
        rows = _contracted(planes.transpose(1, 2, 0), along).transpose(0, 2, 1).astype(np.float32)
        self._rows = np.ascontiguousarray(np.concatenate([rows[..., :1], rows, rows[..., -1:]], -1))

    def less(self, begin: float, layer: int, rows: slice, columns: slice) -> F32:
        """`begin` less the spline in a window of a layer, float32, indexed y, x."""
        out = np.empty((rows.stop - rows.start, columns.stop - columns.start), np.float32)
        less_level(self._rows[layer], self._cell, self._weights, np.float32(begin), rows.start, columns.start, out)
        return out


def control_of_means(means: F64) -> F64:
    """The control points whose spline has the given means over the cells, (nx, ny, nz): a banded solve for each axis.

    Along each axis means are ``(1/6, 2/3, 1/6)`` of the control points, ``(5/6, 1/6)`` at the ends.
    """
    values = means
    for axis in range(3):
        n = means.shape[axis]
        if n > 1:
            diagonal = np.full(n, 2 / 3)
            diagonal[[0, -1]] += 1 / 6
            lines = np.array(np.moveaxis(values, axis, 0), np.float64)
            # elimination without pivoting: the diagonal outweighs the rest of its row
            for k in range(1, n):
                share = 1 / 6 / diagonal[k - 1]
                diagonal[k] -= share / 6
                lines[k] -= share * lines[k - 1]
            lines[-1] /= diagonal[-1]
            for k in range(n - 2, -1, -1):
                lines[k] = (lines[k] - lines[k + 1] / 6) / diagonal[k]
            values = np.moveaxis(lines, 0, axis)
    return values


def control_with_some_held(means: F64, held: Bools) -> F64:
    """Control points (nx, ny, nz) that are zero in the cells `held`, whose spline has the given means over all others.

    By conjugate gradients: the matrix is symmetric, its eigenvalues lie between 1/27 and 1.
    """
    found = np.zeros_like(means)
    residual = np.where(held, 0.0, means)
    direction, square = residual, float((residual**2).sum())
    # of squares: the residual has fallen to 1e-10 of its start
    enough = 1e-20 * square
    while square > enough:
        applied = np.where(held, 0.0, _means_of(direction))
        step = square / float((direction * applied).sum())
        found = found + step * direction
        residual = residual - step * applied
        last, square = square, float((residual**2).sum())
        direction = residual + square / last * direction
    return found


def _means_of(control: F64) -> F64:
    """Means of the spline over the cells."""
    for axis in range(3):
        padded = np.pad(control, [(int(a == axis),) * 2 for a in range(3)], mode="edge")
        ends = [padded.take(range(k, k + control.shape[axis]), axis) for k in range(3)]
        control = (ends[0] + 4 * ends[1] + ends[2]) / 6
    return control


def extended(values: F64, known: Bools, sweeps: int = 200) -> F64:
    """`values` where they are known, elsewhere a smooth continuation: the mean of the neighbors, as far as it spreads.

    Where nothing is known within `sweeps` cells the mean of all known values is taken.
    """
    if known.all() or not known.any():
        return np.where(known, values, 0.0)
    found = np.where(known, values, values[known].mean())
    # Jacobi sweeps; a value spreads by one cell in each
    for _ in range(min(sweeps, 2 * sum(found.shape))):
        padded = np.pad(found, 1, mode="edge")
        around = sum(np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for step in (-1, 1))
        found = np.where(known, values, around / 6)
    return found
