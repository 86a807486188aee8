"""A bucket grid over fixed points, with or without periodic axes: the searches for near pores work outwards from it.

`sppm_pipeline.method.sampling.cell_list` grows while points are thrown and asks for one distance; here all points
are known, lie sorted by bucket, and are looked for ring by ring: ring s of a bucket are the buckets s steps away along
at least one axis and no more along the others. A bucket beyond the end of a periodic axis is an image of one inside.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit


class Buckets(NamedTuple):
    """Points sorted into a box of buckets; bucket (i, j, k) has the number (i ny + j) nz + k."""

    points: F64  # (n, 3), inside the cell along periodic axes
    order: I32  # (n,) points by bucket, and by index within it
    start: I64  # (buckets + 1,) where each bucket begins in `order`
    shape: I64
    origin: F64  # (3,) lower corner of the grid
    width: F64  # (3,) edges of a bucket
    period: F64  # (3,), 0 along axes that do not repeat


def sorted_into_buckets(points: F64, period: F64) -> Buckets:
    """Sort points, of which those on periodic axes lie in [0, period), into buckets of about one point each."""
    lower = np.where(period > 0, 0.0, points.min(axis=0, initial=np.inf))
    extent = np.where(period > 0, period, points.max(axis=0, initial=-np.inf) - lower)
    # a flat set, or a single point, has no extent along some axis; one bucket will do there
    extent = np.maximum(extent, 1e-9 * max(float(extent.max()), 1e-300))
    width = float(np.prod(extent / extent.max())) ** (1 / 3) * float(extent.max()) / max(len(points), 1) ** (1 / 3)
    shape = np.maximum(np.minimum(extent / width, 2.0**20), 1.0).astype(np.int64)
    while np.prod(shape) > 2 * len(points) + 64:
        # thin boxes would have more buckets than points along their long axes
        shape = np.maximum(shape // 2, 1)
    buckets = extent / shape
    order, start = _sort(points, lower, buckets, shape)
    return Buckets(points, order, start, shape, lower, buckets, period.copy())  # writable: kernels are compiled once


@jit
def bucket_along(value: float, origin: float, width: float, count: int) -> int:
    """Index of the bucket along one axis, from 0 to count - 1."""
    return max(0, min(count - 1, int((value - origin) / width)))


@jit
def _sort(points: F64, origin: F64, width: F64, shape: I64) -> tuple[I32, I64]:
    n = points.shape[0]
    number = np.empty(n, np.int32)
    start = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for i in range(n):
        x = bucket_along(points[i, 0], origin[0], width[0], shape[0])
        y = bucket_along(points[i, 1], origin[1], width[1], shape[1])
        z = bucket_along(points[i, 2], origin[2], width[2], shape[2])
        number[i] = (x * shape[1] + y) * shape[2] + z
        start[number[i] + 1] += 1
    for b in range(len(start) - 1):
        start[b + 1] += start[b]
    order = np.empty(n, np.int32)
    for i in range(n):
        order[start[number[i]]] = i
        start[number[i]] += 1
    for b in range(len(start) - 1, 0, -1):
        start[b] = start[b - 1]
    start[0] = 0
    return order, start


@jit
def bucket_of(cells: Buckets, i: int, here: I64) -> None:
    """Write the bucket of point i, along x, y and z, to `here`."""
    for a in range(3):
        here[a] = bucket_along(cells.points[i, a], cells.origin[a], cells.width[a], cells.shape[a])


@jit
def ring_distance(cells: Buckets, here: I64, i: int, ring: int) -> float:
    """No point of this ring around the bucket `here` of point i, or of a later ring, is nearer to i than that."""
    least = np.inf
    for a in range(3):
        offset = cells.points[i, a] - cells.origin[a] - here[a] * cells.width[a]
        step = (ring - 1) * cells.width[a] + min(offset, cells.width[a] - offset)
        least = min(least, step)
    return max(least, 0.0)


@jit
def last_ring(cells: Buckets, here: I64) -> int:
    """The last ring that holds a bucket of the grid, or of the images one period away."""
    last = int(np.int64(0))
    for a in range(3):
        reach = cells.shape[a] + 1 if cells.period[a] > 0 else max(here[a], cells.shape[a] - 1 - here[a])
        last = max(last, reach)
    return last


@jit
def wrapped_bucket(cells: Buckets, here: I64, dx: int, dy: int, dz: int, turn: I64) -> int:
    """Number of the bucket so many steps from `here`, -1 if there is none; `turn` becomes the cells to its image.

    Along a periodic axis images up to one period beyond the bucket's own are reached.
    """
    number = int(np.int64(0))
    for a in range(3):
        step = dx if a == 0 else dy if a == 1 else dz
        index = here[a] + step
        count = cells.shape[a]
        turn[a] = 0
        if index < 0 or index >= count:
            if cells.period[a] == 0 or abs(step) > count + 1:
                return -1
            around = index // count
            index -= around * count
            turn[a] = np.int64(around * cells.period[a])
        number = number * count + index
    return number
