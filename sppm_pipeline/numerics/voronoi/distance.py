"""Distance to the nearest face of Voronoi cells on a grid, cell by cell and row by row.

Within the cell of pore 1 the distance is the least of ``(d_j^2 - d_1^2) / (2 |p_j - p_1|)`` over its neighbors j, each of
them the distance from one plane, linear along a row. Elsewhere that minimum is negative, so the largest over all
cells is the distance, in whatever order they come.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import inline_jit, jit
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.voronoi.cells import VoronoiCells

#: What samples outside of all cells hold before `raise_to_distance` is called.
UNCLAIMED = np.float32(-1e30)
# Rows of a cell are longer by this on either side, so that a sample on a face is in one cell at least.
_SLACK = 1e-9


def raise_to_distance(
    out: NDArray[np.float32], grid: Grid, cells: VoronoiCells, rounding: float = 0.0, threads: int = 1, first_layer: int = 0
) -> None:
    """Raise samples to their distance from the faces of their Voronoi cell, where they lie in one of `cells`.

    Parameters
    ----------
    out : (nz, ny, nx) float32, C-contiguous
        The layers ``first_layer <= k < first_layer + nz`` of the grid; `UNCLAIMED` where no cell has been yet.
    grid : Grid
        In the unit of the cells.
    cells : VoronoiCells
    rounding : float
        Radius of the fillets where faces meet: the distances from the faces are combined by `soft_minimum`.
    threads : int
        Number of threads; the result does not depend on it.
    first_layer : int
    """
    layers = len(out)
    if layers == 0 or len(cells.centers) == 0:
        return
    most = int(np.diff(cells.first).max(initial=1))
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)

    def fill(start: int, stop: int) -> None:
        row = np.empty((most + 1, grid.shape[0]), np.float32)
        _raise_cells(out[start:stop], first_layer + start, origin, spacing, *cells, rounding, row, np.empty((most, 3)))

    if threads == 1 or layers == 1:
        return fill(0, layers)
    height = -(-layers // (4 * threads))
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(lambda start: fill(start, min(start + height, layers)), range(0, layers, height)))
    return None


@inline_jit
def _least(row: NDArray[np.float32], count: int, value: np.float32, step: np.float32) -> None:
    """row[i] = min(row[i], value + i step)."""
    for i in range(np.uint64(count)):
        row[i] = min(row[i], value + step * np.float32(np.int32(i)))


@inline_jit
def _linear(row: NDArray[np.float32], count: int, value: np.float32, step: np.float32) -> None:
    """row[i] = value + i step."""
    for i in range(np.uint64(count)):
        row[i] = value + step * np.float32(np.int32(i))


@inline_jit
def _raise(out: NDArray[np.float32], row: NDArray[np.float32], count: int) -> None:
    for i in range(np.uint64(count)):
        out[i] = max(out[i], row[i])


@jit
def _raise_cells(
    out: NDArray[np.float32],
    first_layer: int,
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    centers: NDArray[np.float64],
    first: NDArray[np.int64],
    planes: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    rounding: float,
    work: NDArray[np.float32],
    lines: NDArray[np.float64],
) -> None:
    """Visit every row of every cell. `work` holds a row for each plane, and one more for the result."""
    nz, ny, nx = out.shape
    hx, hy, hz = spacing[0], spacing[1], spacing[2]
    for k in range(len(centers)):
        z0 = max(math.ceil((lower[k, 2] - _SLACK - origin[2]) / hz), first_layer)
        z1 = min(math.floor((upper[k, 2] + _SLACK - origin[2]) / hz), first_layer + nz - 1)
        y0 = max(math.ceil((lower[k, 1] - _SLACK - origin[1]) / hy), 0)
        y1 = min(math.floor((upper[k, 1] + _SLACK - origin[1]) / hy), ny - 1)
        x0, x1 = lower[k, 0] - centers[k, 0] - _SLACK, upper[k, 0] - centers[k, 0] + _SLACK
        # rows count from the sample beside the pore, so that a sample's rounding depends on its position alone
        beside = math.floor((centers[k, 0] - origin[0]) / hx)
        rest = origin[0] + beside * hx - centers[k, 0]
        count = first[k + 1] - first[k]
        own = planes[first[k] : first[k + 1]]
        for z in range(z0, z1 + 1):
            dz = origin[2] + z * hz - centers[k, 2]
            for y in range(y0, y1 + 1):
                dy = origin[1] + y * hy - centers[k, 1]
                low, high = x0, x1
                for j in range(count):
                    room = own[j, 3] - own[j, 1] * dy - own[j, 2] * dz
                    slope = own[j, 0]
                    lines[j, 0] = room - slope * rest
                    lines[j, 1] = slope * hx
                    if slope > 1e-9:
                        high = min(high, room / slope + _SLACK)
                    elif slope < -1e-9:
                        low = max(low, room / slope - _SLACK)
                    elif room < -_SLACK:
                        high = low - 1.0
                start = max(math.ceil((low - rest) / hx), -beside)
                stop = min(math.floor((high - rest) / hx), nx - 1 - beside) + 1
                if start >= stop:
                    continue
                length = stop - start
                row = work[0]
                row[:length] = np.float32(1e30)
                for j in range(count):
                    _least(row, length, np.float32(lines[j, 0] - start * lines[j, 1]), np.float32(-lines[j, 1]))
                if rounding > 0.0:
                    for j in range(count):
                        at_start = np.float32(lines[j, 0] - start * lines[j, 1])
                        _linear(work[1 + j], length, at_start, np.float32(-lines[j, 1]))
                    _soften(work, count, length, np.float32(rounding))
                target = out[z - first_layer, y, beside + start : beside + stop]
                _raise(target, row, length)


@jit
def _soften(work: NDArray[np.float32], count: int, length: int, radius: np.float32) -> None:
    """Replace the minima in the first row by soft ones, from the values in the others."""
    for i in range(length):
        least = work[0, i]
        near = 0
        for j in range(1, count + 1):
            if work[j, i] < least + radius:
                near += 1
        if near > 1:
            work[0, i] = least - _fillet(work, count, i, least, radius)


@jit
def _fillet(work: NDArray[np.float32], count: int, i: int, least: np.float32, radius: np.float32) -> np.float32:
    """How far the soft minimum lies below the least value: s with sum of max(radius - (v_j - least) - s, 0)^2 = radius^2.

    The sum falls with s and is convex, so Newton's steps from s = 0 never overshoot.
    """
    s = np.float32(0.0)
    for _ in range(12):
        total, slope = -radius * radius, np.float32(0.0)
        for j in range(1, count + 1):
            rest = radius - (work[j, i] - least) - s
            if rest > 0:
                total += rest * rest
                slope += np.float32(2.0) * rest
        step = total / slope
        s += step
        if step <= np.float32(1e-6) * radius:
            break
    return s


def soft_minimum(values: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """The smallest of the values along the last axis, rounded off where others come within `radius` of it.

    It is the m with ``sum of max(m + radius - v_j, 0)^2 = radius^2``: where two distances from orthogonal walls are
    combined, each of its level sets is an offset of the walls with a circular fillet of that radius. It commutes with
    adding a constant, does not depend on the order of the values, and equals the minimum where that stands alone.
    """
    least = values.min(-1)
    if radius <= 0:
        return np.asarray(least)
    s = np.zeros_like(least)
    for _ in range(50):
        rest = np.maximum(radius - (values - least[..., None]) - s[..., None], 0)
        s += ((rest**2).sum(-1) - radius**2) / (2 * rest.sum(-1))
    return np.asarray(least - s)
