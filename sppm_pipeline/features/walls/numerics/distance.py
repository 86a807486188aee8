"""Distance to the nearest face of Voronoi cells on a grid, cell by cell and row by row.

Within the cell of pore 1 the distance is the minimum of ``(d_j^2 - d_1^2) / (2 |p_j - p_1|)`` over its neighbors j,
each of them the distance from one plane, linear along a row. Elsewhere that minimum is negative, so the distance is
the maximum over all cells, in any order.
"""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.features.walls.numerics.cells import VoronoiCells
from sppm_pipeline.method.kernels.rows import LANES
from sppm_pipeline.services.arrays import F32, F64, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import inline_jit, jit
from sppm_pipeline.services.threads import in_bands

#: Initial value of samples, which those outside of all cells keep.
UNCLAIMED = np.float32(-1e30)
# Rows of a cell are extended by this at both ends, so that a sample on a face is in at least one cell.
_SLACK = 1e-9
# Planes whose normal has a smaller component along x count as parallel to the rows.
_PARALLEL = 1e-9
_SHIFT = np.uint64(4)  # log2(LANES)
_INFINITE, _ZERO, _ONE = np.float32(1e30), np.float32(0.0), np.float32(1.0)
# Newton iterations of a soft minimum, and the residual at which they end, as a fraction of the squared radius: some 100
# times single precision. They converge from one side, so fewer leave the fillet slightly sharp; not measured.
_MAX_STEPS, _TOLERANCE = 12, np.float32(1e-5)


def raise_to_distance(
    out: F32, grid: Grid, cells: VoronoiCells, rounding: float = 0.0, threads: int = 1, first_layer: int = 0
) -> None:
    """Raise the samples in `cells` to their distance from the faces of their Voronoi cell, whatever the number of
    threads.

    `out` (nz, ny, nx) are the layers ``first_layer <= k < first_layer + nz`` of the grid, initially `UNCLAIMED`; the
    grid is in the unit of the cells. `rounding` is the radius of the fillets where faces meet: distances v_j from the
    faces become their soft minimum, the m with ``sum of max(m + radius - v_j, 0)^2 = radius^2``. For two orthogonal
    walls its level sets are offsets of the walls with a circular fillet of that radius.
    """
    layers = len(out)
    if layers == 0 or len(cells.centers) == 0:
        return
    max_planes = int(np.diff(cells.first).max(initial=1))
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)

    def fill(start: int, stop: int) -> None:
        block = out[start:stop]
        least, shift, total, slope = (np.empty(grid.shape[0] + LANES, np.float32) for _ in range(4))
        _raise_cells(
            block.reshape(-1), block.shape, first_layer + start, origin, spacing, *cells, rounding,
            least, shift, total, slope,
            np.empty(2 * max_planes, np.float32), np.empty((max_planes, 4)), np.empty(max_planes), np.empty(max_planes),
        )  # fmt: skip

    in_bands(fill, layers, threads)


@inline_jit
def _fill(row: F32, blocks: int, value: np.float32) -> None:
    """Set row[i] = value in whole blocks, which the compiler turns into vector instructions."""
    for i in range(np.uint64(blocks) << _SHIFT):
        row[i] = value


@inline_jit
def _least(row: F32, blocks: int, value: np.float32, step: np.float32) -> None:
    """Lower row[i] to value + i step."""
    for i in range(np.uint64(blocks) << _SHIFT):
        row[i] = min(row[i], value + step * np.float32(np.int32(i)))


@inline_jit
def _raise(out: F32, at: int, row: F32, count: int) -> None:
    first = np.uint64(at)
    for i in range(np.uint64(count)):
        out[first + i] = max(out[first + i], row[i])


@inline_jit
def _ends(room: F64, inverse: F64, rising: int, slanted: int, low: float, high: float) -> tuple[float, float]:
    """Interval of x in which ``x <= room / slope`` for the rising planes, ``>=`` for the falling ones."""
    for j in range(np.uint64(rising)):
        high = min(high, room[j] * inverse[j])
    for j in range(np.uint64(rising), np.uint64(slanted)):
        low = max(low, room[j] * inverse[j])
    return low, high


@jit
def _sorted_planes(planes: F64, first: int, stop: int, own: F64, inverse: F64) -> tuple[int, int]:
    """Copy planes that rise along x, then falling, then parallel ones; return where the second and third kind begin."""
    at = rising = slanted = 0
    for kind in range(3):
        for j in range(first, stop):
            slope = planes[j, 0]
            if kind == (0 if slope > _PARALLEL else 1 if slope < -_PARALLEL else 2):
                for c in range(4):
                    own[at, c] = planes[j, c]
                inverse[at] = 1.0 / slope if kind < 2 else 0.0
                at += 1
        rising, slanted = (at, at) if kind == 0 else (rising, at) if kind == 1 else (rising, slanted)
    return rising, slanted


@jit
def _raise_cells(
    out: F32, shape: tuple[int, int, int], first_layer: int, origin: F64, spacing: F64, centers: F64, first: I64,
    planes: F64, lower: F64, upper: F64, rounding: float, least: F32, shift: F32, total: F32, slope: F32, lines: F32,
    own: F64, inverse: F64, room: F64,
) -> None:  # fmt: skip
    """Process every row of every cell; the arrays from `least` on are scratch."""
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
        # rows count from the sample next to the pore, so that a sample's rounding depends on its position alone
        column = math.floor((centers[k, 0] - origin[0]) / hx)
        rest = origin[0] + column * hx - centers[k, 0]
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
                    if room[j] < -_SLACK:  # the whole row is beyond a parallel plane
                        high = low - 1.0
                if high < low - 2.0 * _SLACK:
                    continue
                start = max(math.ceil((low - _SLACK - rest) / hx), -column)
                stop = min(math.floor((high + _SLACK - rest) / hx), nx - 1 - column) + 1
                if start >= stop:
                    continue
                length = stop - start
                blocks = (length + LANES - 1) // LANES
                x = rest + start * hx
                _fill(least, blocks, _INFINITE)
                for j in range(count):
                    value, step = np.float32(room[j] - own[j, 0] * x), np.float32(-own[j, 0] * hx)
                    _least(least, blocks, value, step)
                    lines[2 * j], lines[2 * j + 1] = value, step
                if rounding > 0.0:
                    _soften(least, shift, total, slope, lines, count, blocks, radius)
                _raise(out, ((z - first_layer) * ny + y) * nx + column + start, least, length)


@inline_jit
def _near(least: F32, blocks: int, value: np.float32, step: np.float32, radius: np.float32) -> np.float32:
    """Count the samples of a row in which a plane comes within the radius of the nearest one."""
    found = _ZERO
    for i in range(np.uint64(blocks) << _SHIFT):
        found += _ONE if value + step * np.float32(np.int32(i)) - least[i] < radius else _ZERO
    return found


@inline_jit
def _add_rests(
    total: F32, slope: F32, least: F32, shift: F32, blocks: int, value: np.float32, step: np.float32
) -> None:
    """Add the contribution of a plane to the sum and to its slope; `value` is that of the plane less the radius."""
    for i in range(np.uint64(blocks) << _SHIFT):
        rest = max(least[i] - shift[i] - value - step * np.float32(np.int32(i)), _ZERO)
        total[i] += rest * rest
        slope[i] += rest


@inline_jit
def _step(total: F32, slope: F32, shift: F32, blocks: int) -> np.float32:
    """Take a Newton step; returns the residual before it, summed over the row."""
    left = _ZERO
    for i in range(np.uint64(blocks) << _SHIFT):
        shift[i] += np.float32(0.5) * total[i] / slope[i]
        left += total[i]
    return left


@inline_jit
def _lower(least: F32, shift: F32, blocks: int) -> None:
    for i in range(np.uint64(blocks) << _SHIFT):
        least[i] -= shift[i]


@inline_jit
def _soften(
    least: F32, shift: F32, total: F32, slope: F32, lines: F32, count: int, blocks: int, radius: np.float32
) -> None:
    """Lower the minimum of some lines to their soft minimum, by Newton's method for a whole row at once."""
    # the sum of max(radius - (v_j - least) - s, 0)^2 falls with s and is convex: steps from s = 0 never overshoot
    near = np.uint64(0)  # planes that come within the radius anywhere in the row; the rest can't contribute
    for j in range(np.uint64(count)):
        value, step = lines[2 * j], lines[2 * j + np.uint64(1)]
        if _near(least, blocks, value, step, radius) > _ZERO:
            lines[2 * near], lines[2 * near + np.uint64(1)] = value - radius, step
            near += np.uint64(1)
    if near < np.uint64(2):
        return
    _fill(shift, blocks, _ZERO)
    for _ in range(_MAX_STEPS):
        _fill(total, blocks, -radius * radius)
        _fill(slope, blocks, _ZERO)
        for j in range(near):
            _add_rests(total, slope, least, shift, blocks, lines[2 * j], lines[2 * j + np.uint64(1)])
        if _step(total, slope, shift, blocks) <= _TOLERANCE * radius * radius:
            break
    _lower(least, shift, blocks)
