"""Distance to the nearest face of Voronoi cells on a grid, cell by cell and row by row.

Within the cell of pore 1 the distance is the least of ``(d_j^2 - d_1^2) / (2 |p_j - p_1|)`` over its neighbors j, each
of them the distance from one plane, linear along a row. Elsewhere that minimum is negative, so the largest over all
cells is the distance, in whatever order they come.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.walls.numerics.cells import VoronoiCells
from sppm_pipeline.method.kernels.rows import LANES
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands

#: What samples outside of all cells hold before `raise_to_distance` is called.
UNCLAIMED = np.float32(-1e30)
# Rows of a cell are longer by this on either side, so that a sample on a face is in one cell at least.
_SLACK = 1e-9
# Planes whose normal has a smaller part along x run along the rows.
_ALONG = 1e-9
_SHIFT = np.uint64(4)
_FAR, _ZERO, _ONE = np.float32(1e30), np.float32(0.0), np.float32(1.0)
# Newton's steps of a soft minimum, and the share of the squared radius at which they end.
_STEPS, _ENOUGH = 12, np.float32(1e-5)


def raise_to_distance(
    out: NDArray[np.float32],
    grid: Grid,
    cells: VoronoiCells,
    rounding: float = 0.0,
    threads: int = 1,
    first_layer: int = 0,
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
        block = out[start:stop]
        least, shift, total, slope = (np.empty(grid.shape[0] + LANES, np.float32) for _ in range(4))
        _raise_cells(
            block.reshape(-1), block.shape, first_layer + start, origin, spacing, *cells, rounding,
            least, shift, total, slope,
            np.empty(2 * most, np.float32), np.empty((most, 4)), np.empty(most), np.empty(most),
        )  # fmt: skip

    in_bands(fill, layers, threads)


@inline_jit
def _fill(row: NDArray[np.float32], blocks: int, value: np.float32) -> None:
    """row[i] = value for whole blocks, which the compiler turns into vector instructions."""
    for i in range(np.uint64(blocks) << _SHIFT):
        row[i] = value


@inline_jit
def _least(row: NDArray[np.float32], blocks: int, value: np.float32, step: np.float32) -> None:
    """row[i] = min(row[i], value + i step)."""
    for i in range(np.uint64(blocks) << _SHIFT):
        row[i] = min(row[i], value + step * np.float32(np.int32(i)))


@inline_jit
def _raise(out: NDArray[np.float32], at: int, row: NDArray[np.float32], count: int) -> None:
    first = np.uint64(at)
    for i in range(np.uint64(count)):
        out[first + i] = max(out[first + i], row[i])


@inline_jit
def _ends(
    room: NDArray[np.float64], inverse: NDArray[np.float64], rising: int, slanted: int, low: float, high: float
) -> tuple[float, float]:
    """The interval of x in which ``x <= room / slope`` for the rising planes, ``>=`` for the falling ones."""
    for j in range(np.uint64(rising)):
        high = min(high, room[j] * inverse[j])
    for j in range(np.uint64(rising), np.uint64(slanted)):
        low = max(low, room[j] * inverse[j])
    return low, high


@jit
def _sorted_planes(
    planes: NDArray[np.float64], first: int, stop: int, own: NDArray[np.float64], inverse: NDArray[np.float64]
) -> tuple[int, int]:
    """Copy planes: those that rise along x, that fall, and that run along x; where the second and third kind begin."""
    at = rising = slanted = 0
    for kind in range(3):
        for j in range(first, stop):
            slope = planes[j, 0]
            if kind == (0 if slope > _ALONG else 1 if slope < -_ALONG else 2):
                for c in range(4):
                    own[at, c] = planes[j, c]
                inverse[at] = 1.0 / slope if kind < 2 else 0.0
                at += 1
        rising, slanted = (at, at) if kind == 0 else (rising, at) if kind == 1 else (rising, slanted)
    return rising, slanted


@jit
def _raise_cells(
    out: NDArray[np.float32],
    shape: tuple[int, int, int],
    first_layer: int,
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    centers: NDArray[np.float64],
    first: NDArray[np.int64],
    planes: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    rounding: float,
    least: NDArray[np.float32],
    shift: NDArray[np.float32],
    total: NDArray[np.float32],
    slope: NDArray[np.float32],
    lines: NDArray[np.float32],
    own: NDArray[np.float64],
    inverse: NDArray[np.float64],
    room: NDArray[np.float64],
) -> None:
    """Visit every row of every cell; the arrays from `least` on are work space."""
    nz, ny, nx = shape
    hx, hy, hz = spacing[0], spacing[1], spacing[2]
    radius = np.float32(rounding)
    for k in range(len(centers)):
        z0 = max(math.ceil((lower[k, 2] - _SLACK - origin[2]) / hz), first_layer)
        z1 = min(math.floor((upper[k, 2] + _SLACK - origin[2]) / hz), first_layer + nz - 1)
        y0 = max(math.ceil((lower[k, 1] - _SLACK - origin[1]) / hy), 0)
        y1 = min(math.floor((upper[k, 1] + _SLACK - origin[1]) / hy), ny - 1)
        if z0 > z1 or y0 > y1:
            continue
        # rows count from the sample beside the pore, so that a sample's rounding depends on its position alone
        beside = math.floor((centers[k, 0] - origin[0]) / hx)
        rest = origin[0] + beside * hx - centers[k, 0]
        x0, x1 = lower[k, 0] - centers[k, 0], upper[k, 0] - centers[k, 0]
        count = first[k + 1] - first[k]
        rising, slanted = _sorted_planes(planes, first[k], first[k + 1], own, inverse)
        for z in range(z0, z1 + 1):
            dz = origin[2] + z * hz - centers[k, 2]
            for y in range(y0, y1 + 1):
                dy = origin[1] + y * hy - centers[k, 1]
                for j in range(count):
                    room[j] = own[j, 3] - own[j, 1] * dy - own[j, 2] * dz
                low, high = _ends(room, inverse, rising, slanted, x0, x1)
                for j in range(slanted, count):
                    if room[j] < -_SLACK:
                        high = low - 1.0
                if high < low - 2.0 * _SLACK:
                    continue
                start = max(math.ceil((low - _SLACK - rest) / hx), -beside)
                stop = min(math.floor((high + _SLACK - rest) / hx), nx - 1 - beside) + 1
                if start >= stop:
                    continue
                length = stop - start
                blocks = (length + LANES - 1) // LANES
                x = rest + start * hx
                _fill(least, blocks, _FAR)
                for j in range(count):
                    value, step = np.float32(room[j] - own[j, 0] * x), np.float32(-own[j, 0] * hx)
                    _least(least, blocks, value, step)
                    lines[2 * j], lines[2 * j + 1] = value, step
                if rounding > 0.0:
                    _soften(least, shift, total, slope, lines, count, blocks, radius)
                _raise(out, ((z - first_layer) * ny + y) * nx + beside + start, least, length)


@inline_jit
def _near(
    least: NDArray[np.float32], blocks: int, value: np.float32, step: np.float32, radius: np.float32
) -> np.float32:
    """In how many samples of a row a plane comes within the radius of the nearest one."""
    found = _ZERO
    for i in range(np.uint64(blocks) << _SHIFT):
        found += _ONE if value + step * np.float32(np.int32(i)) - least[i] < radius else _ZERO
    return found


@inline_jit
def _add_rests(
    total: NDArray[np.float32],
    slope: NDArray[np.float32],
    least: NDArray[np.float32],
    shift: NDArray[np.float32],
    blocks: int,
    value: np.float32,
    step: np.float32,
) -> None:
    """Add what a plane gives to the sum and to its slope; `value` is that of the plane less the radius."""
    for i in range(np.uint64(blocks) << _SHIFT):
        rest = max(least[i] - shift[i] - value - step * np.float32(np.int32(i)), _ZERO)
        total[i] += rest * rest
        slope[i] += rest


@inline_jit
def _step(
    total: NDArray[np.float32], slope: NDArray[np.float32], shift: NDArray[np.float32], blocks: int
) -> np.float32:
    """A step of Newton's method; returns the sum over the row of what was left before it."""
    left = _ZERO
    for i in range(np.uint64(blocks) << _SHIFT):
        shift[i] += np.float32(0.5) * total[i] / slope[i]
        left += total[i]
    return left


@inline_jit
def _lower(least: NDArray[np.float32], shift: NDArray[np.float32], blocks: int) -> None:
    for i in range(np.uint64(blocks) << _SHIFT):
        least[i] -= shift[i]


@inline_jit
def _soften(
    least: NDArray[np.float32],
    shift: NDArray[np.float32],
    total: NDArray[np.float32],
    slope: NDArray[np.float32],
    lines: NDArray[np.float32],
    count: int,
    blocks: int,
    radius: np.float32,
) -> None:
    """Lower the least of some lines to their soft minimum, by Newton's method for a whole row at once.

    The sum of ``max(radius - (v_j - least) - s, 0)^2`` falls with s and is convex, so the steps from s = 0 to where it
    is radius^2 never overshoot.
    """
    near = np.uint64(0)
    for j in range(np.uint64(count)):
        value, step = lines[2 * j], lines[2 * j + np.uint64(1)]
        if _near(least, blocks, value, step, radius) > _ZERO:
            lines[2 * near], lines[2 * near + np.uint64(1)] = value - radius, step
            near += np.uint64(1)
    if near < np.uint64(2):
        return
    _fill(shift, blocks, _ZERO)
    for _ in range(_STEPS):
        _fill(total, blocks, -radius * radius)
        _fill(slope, blocks, _ZERO)
        for j in range(near):
            _add_rests(total, slope, least, shift, blocks, lines[2 * j], lines[2 * j + np.uint64(1)])
        if _step(total, slope, shift, blocks) <= _ENOUGH * radius * radius:
            break
    _lower(least, shift, blocks)


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
