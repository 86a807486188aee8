"""Building blocks of the samplers: a stream of uniform numbers, and a bucket grid (cell list) over points.

The grid answers "is this spot free?" at a cost that does not grow with the number of points.

Each bucket is at least one spacing wide, so that only a bucket and its neighbors have to be searched. A periodic axis
has period 1, and distances along it are measured to the nearest image; with fewer than three buckets along an axis
all of them are searched.

Points carry a family and a member. Two points of one family but different members never meet (two colors of the same
face), so they ignore each other; every other pair keeps the spacing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64, U64
from sppm_pipeline.services.jit.compiled import jit

# A kernel draws one uniform number after another from one word of state, so that no chunk size, buffer or thread count
# enters the result: SplitMix64 (Steele, Lea and Flood 2014), whose output function is a bijection of a counter.
_STEP = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)


def new_stream(rng: np.random.Generator, number: int = 1) -> U64:
    """States (number,) of streams whose starts are drawn from `rng` (one 64-bit draw each)."""
    return rng.integers(0, 2**64, size=number, dtype=np.uint64)


@jit
def next_uniform(stream: U64) -> float:
    """Advance `stream` and return a number in [0, 1) with 53 random bits."""
    stream[0] += _STEP
    word = stream[0]
    word = (word ^ (word >> _S30)) * _FIRST
    word = (word ^ (word >> _S27)) * _SECOND
    word = word ^ (word >> _S31)
    return np.float64(word >> _S11) * 2.0**-53


# Distances are sums of a few rounded coordinates below 2; this much is added to the spacing that is asked for, so that
# no later measurement, in whatever order it subtracts, finds less than the spacing.
_ROUNDING = 1e-14


class CellList(NamedTuple):
    """Points sorted into buckets; `used[0]` of the rows of `points` are filled."""

    points: F64  # (capacity, 3)
    family: I64  # (capacity,)
    member: I64  # (capacity,)
    following: I64  # (capacity,) next point of the same bucket, -1 at the end
    first: I64  # (nz, ny, nx) first point of each bucket, -1 when empty
    used: I64  # (1,)
    origin: F64  # (3,) lower corner of the grid
    width: F64  # (3,) bucket edges
    period: F64  # (3,) 1 along periodic axes, otherwise infinite
    reach: float  # spacing kept between points


def empty_cell_list(capacity: int, spacing: float, lower: F64, upper: F64, periodic: Sequence[bool]) -> CellList:
    """A cell list for `capacity` points, covering the box and, along axes that are not periodic, one spacing around it.

    The spacing is the distance to be kept, at most 1 when an axis is periodic (period 1); spots are asked for between
    `lower` and `upper` only.
    """
    wraps = np.asarray(periodic, dtype=np.bool_)
    reach = spacing + _ROUNDING
    origin = np.where(wraps, lower, lower - reach)
    extent = np.where(wraps, 1.0, upper - lower + 2.0 * reach)
    # Buckets smaller than the mean room of a point only cost memory: a tiny spacing must not open millions of them.
    limit = 4 * capacity + 64
    size = reach
    while math.prod(max(1, int(length / size)) for length in extent) > limit:
        size *= 1.25
    shape = np.maximum(1, (extent / size).astype(np.int64))
    return CellList(
        points=np.empty((capacity, 3)), family=np.zeros(capacity, dtype=np.int64),
        member=np.zeros(capacity, dtype=np.int64), following=np.full(capacity, -1, dtype=np.int64),
        first=np.full((int(shape[2]), int(shape[1]), int(shape[0])), -1, dtype=np.int64),
        used=np.zeros(1, dtype=np.int64), origin=origin, width=extent / shape, period=np.where(wraps, 1.0, np.inf),
        reach=float(reach),
    )  # fmt: skip


@jit
def bucket_along(value: float, origin: float, width: float, count: int, wraps: bool) -> int:
    """Index of the bucket of a coordinate along one axis; outside the grid the outermost bucket."""
    offset = value - origin
    if wraps:
        offset -= np.floor(offset)
    return max(0, min(count - 1, int(offset / width)))


@jit
def bucket_of(cells: CellList, x: float, y: float, z: float) -> tuple[int, int, int]:
    """Indices of the bucket of a position, in the order x, y, z."""
    nz, ny, nx = cells.first.shape
    i = bucket_along(x, cells.origin[0], cells.width[0], nx, cells.period[0] == 1.0)
    j = bucket_along(y, cells.origin[1], cells.width[1], ny, cells.period[1] == 1.0)
    k = bucket_along(z, cells.origin[2], cells.width[2], nz, cells.period[2] == 1.0)
    return i, j, k


@jit
def add_point(cells: CellList, x: float, y: float, z: float, family: int, member: int) -> None:
    """Add one point without looking at the spacing."""
    row = cells.used[0]
    cells.used[0] = row + 1
    cells.points[row, 0] = x
    cells.points[row, 1] = y
    cells.points[row, 2] = z
    cells.family[row] = family
    cells.member[row] = member
    i, j, k = bucket_of(cells, x, y, z)
    cells.following[row] = cells.first[k, j, i]
    cells.first[k, j, i] = row


@jit
def add_points(cells: CellList, points: F64, family: int, member: int) -> None:
    """Add the points (n, 3) without looking at the spacing."""
    for row in range(points.shape[0]):
        add_point(cells, points[row, 0], points[row, 1], points[row, 2], family, member)


@jit
def axis_gap(a: float, b: float, period: float) -> float:
    """Distance of two coordinates that differ by at most one period."""
    gap = abs(a - b)
    return min(gap, abs(period - gap))


@jit
def _free_of_bucket(row: int, cells: CellList, spot: tuple[float, float, float], family: int, member: int) -> bool:
    points, period = cells.points, cells.period
    reach2 = cells.reach * cells.reach
    while row >= 0:
        dx = axis_gap(points[row, 0], spot[0], period[0])
        dy = axis_gap(points[row, 1], spot[1], period[1])
        dz = axis_gap(points[row, 2], spot[2], period[2])
        if dx * dx + dy * dy + dz * dz < reach2 and (cells.family[row] != family or cells.member[row] == member):
            return False
        row = cells.following[row]
    return True


@jit
def search_range(index: int, count: int, wraps: bool) -> tuple[int, int]:
    """First bucket and number of buckets to search along an axis; the range may pass either end (`wrapped`)."""
    if count < 3:
        return 0, count
    if wraps:
        return index - 1, 3
    start = max(index - 1, 0)
    return start, min(index + 1, count - 1) - start + 1


@jit
def wrapped(index: int, count: int) -> int:
    """An index that is at most `count` beyond either end, brought back into 0 <= index < count."""
    if index < 0:
        return index + count
    if index >= count:
        return index - count
    return index


@jit
def is_free(cells: CellList, spot: tuple[float, float, float], family: int, member: int) -> bool:
    """True if no point lies closer to the spot than the spacing."""
    nz, ny, nx = cells.first.shape
    i, j, k = bucket_of(cells, spot[0], spot[1], spot[2])
    # Most darts that fail do so in their own bucket.
    if not _free_of_bucket(cells.first[k, j, i], cells, spot, family, member):
        return False
    i0, ni = search_range(i, nx, cells.period[0] == 1.0)
    j0, nj = search_range(j, ny, cells.period[1] == 1.0)
    k0, nk = search_range(k, nz, cells.period[2] == 1.0)
    for dk in range(nk):
        kk = wrapped(k0 + dk, nz)
        for dj in range(nj):
            jj = wrapped(j0 + dj, ny)
            for di in range(ni):
                row = cells.first[kk, jj, wrapped(i0 + di, nx)]
                if row >= 0 and not _free_of_bucket(row, cells, spot, family, member):
                    return False
    return True
