"""Sample elimination: exactly n well-spread points, without a spacing to be chosen.

Yuksel 2015, "Sample elimination for generating Poisson disk sample sets" (Computer Graphics Forum 34): start from many
random points and take away, one by one, the point with the largest weight (a sum over near neighbors), until n are
left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.cell_list import (
    CellList,
    add_points,
    bucket_of,
    empty_cell_list,
    search_range,
    wrapped,
)
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit

# The constants of the paper: the weight's exponent is 8 (three squarings below); neighbors nearer than a fraction
# BETA (1 - (n / m)^GAMMA) of the ideal distance weigh no more than at that distance.
_BETA, _GAMMA = 0.65, 1.5


@jit
def _sift(heap: I64, place: I64, weight: F64, size: int | np.int64, slot: int) -> None:
    """Restore the order of a heap with the largest weight on top, after the weight at `slot` changed."""
    row = heap[slot]
    while slot > 0:
        parent = (slot - 1) // 2
        if weight[heap[parent]] >= weight[row]:
            break
        heap[slot] = heap[parent]
        place[heap[slot]] = slot
        slot = parent
    while 2 * slot + 1 < size:
        child = 2 * slot + 1
        if child + 1 < size and weight[heap[child + 1]] > weight[heap[child]]:
            child += 1
        if weight[heap[child]] <= weight[row]:
            break
        heap[slot] = heap[child]
        place[heap[slot]] = slot
        slot = child
    heap[slot] = row
    place[row] = slot


@jit
def _spread(
    cells: CellList, row: int, nearest: float, weight: F64, heap: I64, place: I64, size: int | np.int64
) -> None:
    """Pass over the neighbors of a point: sum their weights into it (size 0), or take its weight from them.

    In the second case `size` is that of the heap, whose order is kept; points out of the heap have place -1.
    """
    points, period = cells.points, cells.period
    nz, ny, nx = cells.first.shape
    i, j, k = bucket_of(cells, points[row, 0], points[row, 1], points[row, 2])
    i0, ni = search_range(i, nx, period[0] == 1.0)
    j0, nj = search_range(j, ny, period[1] == 1.0)
    k0, nk = search_range(k, nz, period[2] == 1.0)
    for step in range(nk * nj * ni):
        kk = wrapped(k0 + step // (nj * ni), nz)
        jj = wrapped(j0 + step // ni % nj, ny)
        ii = wrapped(i0 + step % ni, nx)
        other = cells.first[kk, jj, ii]
        while other >= 0:
            if other != row and place[other] >= 0:
                total = 0.0
                for axis in range(3):
                    gap = abs(points[row, axis] - points[other, axis])
                    gap = min(gap, abs(period[axis] - gap))
                    total += gap * gap
                near = 1.0 - max(np.sqrt(total), nearest) / cells.reach
                if near > 0.0:
                    near *= near
                    near *= near
                    near *= near
                    if size == 0:
                        weight[row] += near
                    else:
                        weight[other] -= near
                        _sift(heap, place, weight, size, place[other])
            other = cells.following[other]


@jit
def _eliminate(cells: CellList, count: int, nearest: float) -> I64:
    """Rows of all points: the `count` that are left, then those taken away, the last one first."""
    size = cells.used[0]
    heap, place = np.arange(size), np.arange(size)
    weight = np.zeros(size)
    none = np.int64(0)  # typed: a literal would compile a second version of the kernel
    for row in range(size):
        _spread(cells, row, nearest, weight, heap, place, none)
    for slot in range(size):
        _sift(heap, place, weight, slot + 1, slot)
    while size > count:
        row = heap[0]
        size -= 1
        place[row] = -1
        if size > 0:
            heap[0] = heap[size]
            place[heap[0]] = 0
            _sift(heap, place, weight, size, place[heap[0]])
            _spread(cells, row, nearest, weight, heap, place, size)
        heap[size] = row
    return heap


def elimination_order(points: F64, count: int, lower: ArrayLike, upper: ArrayLike, periodic: Sequence[bool]) -> I64:
    """Remove the point with the largest weight, again and again, until `count` of the points (m, 3) are left.

    Returns rows of `points`, (m,): the `count` that are left, ascending, then those taken away, the last one first.
    Equal coordinates of `lower` and `upper` along an axis mean a plane or a line; periodic axes have period 1.
    """
    low = np.ascontiguousarray(lower, dtype=np.float64)
    side = np.asarray(upper, dtype=np.float64) - low
    used = side[side > 0.0]
    if count in (0, len(points)) or len(used) == 0:
        return np.arange(len(points))
    # Distance of the points in the densest lattice of this dimension: no set of `count` points can be wider.
    room = float(np.prod(used)) / count
    ideal = {1: room, 2: math.sqrt(room * 2.0 / math.sqrt(3.0)), 3: math.cbrt(room * math.sqrt(2.0))}[len(used)]
    nearest = ideal * _BETA * (1.0 - math.pow(count / len(points), _GAMMA))
    cells = empty_cell_list(len(points), ideal, low, low + side, periodic)
    add_points(cells, points, 0, 0)
    order = _eliminate(cells, count, nearest)
    order[:count].sort()
    return order


def eliminate(
    rng: np.random.Generator,
    count: int,
    lower: ArrayLike,
    upper: ArrayLike,
    *,
    periodic: Sequence[bool] = (False, False, False),
    oversampling: float = 5.0,
) -> F64:
    """Exactly `count` points with a spacing as large as elimination makes it, some 0.7 of the densest packing's.

    Starts from ``oversampling * count`` random points, at least 1 times. Equal coordinates of `lower` and `upper` along
    an axis give points in a plane or on a line. Along axes that are not periodic (period 1) points gather at the walls,
    as nothing outside adds weight. Returns (count, 3), cell sizes, in no meaningful order; raises DesignError for a
    negative count or an oversampling below 1.
    """
    if count < 0 or not 1.0 <= oversampling < math.inf:
        raise DesignError(f"need count >= 0 and oversampling >= 1, got {count} and {oversampling}")
    low = np.asarray(lower, dtype=np.float64)
    side = np.asarray(upper, dtype=np.float64) - low
    points = low + side * rng.random((math.ceil(oversampling * count), 3))
    return points[elimination_order(points, count, lower, upper, periodic)[:count]]
