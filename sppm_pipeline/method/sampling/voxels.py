"""Voxels that may hold a free spot, and which points reach into each of them.

The voxels of the first level, the *roots*, fill the box. Those that a single point covers are dropped, and at every
further level each voxel is split into parts, of which the covered ones are dropped again. The parts of a root follow
each other, so that a new point finds the voxels it reaches into by the roots around it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.method.sampling.cell_list import CellList, axis_gap
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit

# A point that reaches into a voxel by less than the rounding of distances may be listed in vain.
_SLACK = 1e-9

Triple = tuple[float, float, float]


class Voxels(NamedTuple):
    """The voxels of one level; a spot in one of them is covered only by points listed for it, or by newer ones."""

    places: I64  # (number or more, 3) steps of the voxel's edge along x, y, z
    first: I64  # (number + 1 or more,) where the points of each begin
    points: I64  # (first[number] or more,) rows of the cell list
    begin: I64  # (roots + 1,) where the voxels of each root begin
    number: int


@jit
def _squares(cells: CellList, p: int, middle: Triple, edge: Triple) -> tuple[float, float]:
    """Squared distances from a point to the far end of a voxel and to its near end."""
    dx = axis_gap(cells.points[p, 0], middle[0], cells.period[0])
    dy = axis_gap(cells.points[p, 1], middle[1], cells.period[1])
    dz = axis_gap(cells.points[p, 2], middle[2], cells.period[2])
    fx, fy, fz = dx + edge[0] / 2, dy + edge[1] / 2, dz + edge[2] / 2
    far = fx * fx + fy * fy + fz * fz
    nx, ny, nz = max(dx - edge[0] / 2, 0.0), max(dy - edge[1] / 2, 0.0), max(dz - edge[2] / 2, 0.0)
    close = nx * nx + ny * ny + nz * nz
    return far, close


@jit
def _root_range(
    cells: CellList, p: int, axis: int, shift: int, lower: F64, edge: Triple, roots: tuple[int, int, int]
) -> tuple[int, int]:
    """The roots from one to before another that an image of a point may reach into, along one axis."""
    x = cells.points[p, axis] + shift - lower[axis]
    reach = cells.reach * (1.0 + _SLACK)
    if edge[axis] == 0.0:
        return 0, 1 if abs(x) <= reach else 0
    low = np.floor((x - reach) / edge[axis])
    high = np.floor((x + reach) / edge[axis]) + 1.0
    return int(max(low, 0.0)), int(min(high, float(roots[axis])))


@jit
def all_voxels(
    cells: CellList, lower: F64, edge: Triple, roots: tuple[int, int, int], family: int, member: int
) -> Voxels:
    """The roots, so many along each axis with these edges, that no single point covers.

    Points of the same `family` but another `member` do not count.
    """
    number = roots[0] * roots[1] * roots[2]
    covered = np.zeros(number, np.bool_)
    latest = np.full(number, -1, np.int64)
    start = np.zeros(number + 1, np.int64)
    points = np.empty(0, np.int64)
    wraps = (int(cells.period[0] == 1.0), int(cells.period[1] == 1.0), int(cells.period[2] == 1.0))
    reach2 = cells.reach * cells.reach
    for filling in range(2):
        for p in range(cells.used[0]):
            if cells.family[p] == family and cells.member[p] != member:
                continue
            for sz in range(-wraps[2], wraps[2] + 1):
                k0, k1 = _root_range(cells, p, 2, sz, lower, edge, roots)
                for sy in range(-wraps[1], wraps[1] + 1 if k0 < k1 else -wraps[1]):
                    j0, j1 = _root_range(cells, p, 1, sy, lower, edge, roots)
                    for sx in range(-wraps[0], wraps[0] + 1 if j0 < j1 else -wraps[0]):
                        i0, i1 = _root_range(cells, p, 0, sx, lower, edge, roots)
                        for k in range(k0, k1):
                            z = lower[2] + k * edge[2] + edge[2] / 2
                            for j in range(j0, j1):
                                y = lower[1] + j * edge[1] + edge[1] / 2
                                for i in range(i0, i1):
                                    root = (k * roots[1] + j) * roots[0] + i
                                    # two images may reach into one root of a small box
                                    if covered[root] or latest[root] == p:
                                        continue
                                    x = lower[0] + i * edge[0] + edge[0] / 2
                                    far, close = _squares(cells, p, (x, y, z), edge)
                                    if far < reach2:
                                        covered[root] = True
                                    elif close < reach2 * (1.0 + _SLACK):
                                        latest[root] = p
                                        if filling:
                                            points[start[root]] = p
                                        start[root + (1 - filling)] += 1
        for root in range(number):
            latest[root] = -1
            if not filling:
                start[root + 1] = start[root] + (0 if covered[root] else start[root + 1])
        if not filling:
            points = np.empty(start[number], np.int64)
    count = number - covered.sum()
    places, first, begin = np.empty((count, 3), np.int64), np.zeros(count + 1, np.int64), np.zeros(number + 1, np.int64)
    row = 0
    for root in range(number):
        if not covered[root]:
            places[row, 0] = root % roots[0]
            places[row, 1] = root // roots[0] % roots[1]
            places[row, 2] = root // roots[0] // roots[1]
            first[row + 1] = start[root]
            row += 1
        begin[root + 1] = row
    return Voxels(places, first, points, begin, count)


@jit
def _news(
    cells: CellList, voxels: Voxels, lower: F64, edge: Triple, roots: tuple[int, int, int], wide: Triple, since: int
) -> tuple[I64, I64]:
    """Points from row `since` on that reach into each voxel: chains of rows (point, next) and where each starts."""
    head = np.full(voxels.number, -1, np.int64)
    chain = np.empty(64, np.int64)
    used = 0
    wraps = (int(cells.period[0] == 1.0), int(cells.period[1] == 1.0), int(cells.period[2] == 1.0))
    for p in range(since, cells.used[0]):
        for sz in range(-wraps[2], wraps[2] + 1):
            k0, k1 = _root_range(cells, p, 2, sz, lower, wide, roots)
            for sy in range(-wraps[1], wraps[1] + 1 if k0 < k1 else -wraps[1]):
                j0, j1 = _root_range(cells, p, 1, sy, lower, wide, roots)
                for sx in range(-wraps[0], wraps[0] + 1 if j0 < j1 else -wraps[0]):
                    i0, i1 = _root_range(cells, p, 0, sx, lower, wide, roots)
                    for k in range(k0, k1):
                        for j in range(j0, j1):
                            line = (k * roots[1] + j) * roots[0]
                            for row in range(voxels.begin[line + i0], voxels.begin[line + max(i0, i1)]):
                                middle = (
                                    lower[0] + voxels.places[row, 0] * edge[0] + edge[0] / 2,
                                    lower[1] + voxels.places[row, 1] * edge[1] + edge[1] / 2,
                                    lower[2] + voxels.places[row, 2] * edge[2] + edge[2] / 2,
                                )
                                _, close = _squares(cells, p, middle, edge)
                                known = head[row] >= 0 and chain[head[row]] == p
                                if known or close >= cells.reach * cells.reach * (1.0 + _SLACK):
                                    continue
                                if used + 2 > len(chain):
                                    chain = _longer(chain, used)
                                chain[used] = p
                                chain[used + 1] = head[row]
                                head[row] = used
                                used += 2
    return head, chain


@jit
def halved(
    cells: CellList,
    voxels: Voxels,
    lower: F64,
    edge: F64,
    parts: I64,
    roots: tuple[int, int, int],
    wide: Triple,
    since: int,
) -> Voxels:
    """The parts of the voxels that no single point covers, `parts` (1 or 2) along each axis.

    `edge` (3,) is the edge of the parts, `wide` that of the roots. Points from row `since` on are new.
    """
    whole = (edge[0] * parts[0], edge[1] * parts[1], edge[2] * parts[2])
    head, chain = _news(cells, voxels, lower, whole, roots, wide, since)
    near, masks = np.empty(len(cells.points), np.int64), np.empty(len(cells.points), np.int64)
    work = np.zeros((6, 2))
    room = 2 * voxels.number + 64
    places, first, points = np.empty((room, 3), np.int64), np.zeros(room + 1, np.int64), np.empty(4 * room, np.int64)
    begin = np.zeros(len(voxels.begin), np.int64)
    count = int(np.int64(0))  # a constant would be another type, for which what is called is compiled once more
    for root in range(len(begin) - 1):
        for row in range(voxels.begin[root], voxels.begin[root + 1]):
            found = 0
            for s in range(voxels.first[row], voxels.first[row + 1]):
                near[found] = voxels.points[s]
                found += 1
            s = head[row]
            while s >= 0:
                near[found] = chain[s]
                found += 1
                s = chain[s + 1]
            while count + 8 > places.shape[0]:
                places = _longer(places.ravel(), 3 * count).reshape(-1, 3)
                first = _longer(first, count + 1)
            while first[count] + 8 * found > len(points):
                points = _longer(points, first[count])
            count = _add_parts(
                cells, lower, edge, parts, voxels.places[row], near, masks, work, found, places, first, points, count
            )
        begin[root + 1] = count
    return Voxels(places, first, points, begin, count)


@jit
def _longer(array: I64, used: int) -> I64:
    """Twice the array."""
    longer = np.empty(2 * len(array), np.int64)
    # a slice assignment would compile Numba's broadcasting errors: two seconds more
    for row in range(used):
        longer[row] = array[row]
    return longer


@jit
def _add_parts(
    cells: CellList,
    lower: F64,
    edge: F64,
    parts: I64,
    place: I64,
    near: I64,
    masks: I64,
    work: F64,
    found: int,
    places: I64,
    first: I64,
    points: I64,
    count: int,
) -> int:
    """Write those parts of the voxel at `place` that none of the `found` points in `near` covers; their new number."""
    reach2 = cells.reach * cells.reach
    near2 = reach2 * (1.0 + _SLACK)
    half = (edge[0] / 2, edge[1] / 2, edge[2] / 2)
    start = (place[0] * parts[0], place[1] * parts[1], place[2] * parts[2])
    # squared distances along each axis from both parts: to the far end of the part, and to its near end
    far, close = work[:3], work[3:]
    covered = 0
    for s in range(found):
        p = near[s]
        for axis in range(3):
            for part in range(parts[axis]):
                middle = lower[axis] + (start[axis] + part) * edge[axis] + half[axis]
                gap = axis_gap(cells.points[p, axis], middle, cells.period[axis])
                beyond = max(gap - half[axis], 0.0)
                far[axis, part] = (gap + half[axis]) * (gap + half[axis])
                close[axis, part] = beyond * beyond
        reached, bit = 0, 1
        for c in range(2):
            for b in range(2):
                for a in range(2):
                    if far[0, a] + far[1, b] + far[2, c] < reach2:
                        covered |= bit
                    if close[0, a] + close[1, b] + close[2, c] < near2:
                        reached |= bit
                    bit <<= 1
        masks[s] = reached
    used = first[count]
    for c in range(parts[2]):
        for b in range(parts[1]):
            for a in range(parts[0]):
                bit = 1 << (4 * c + 2 * b + a)
                if covered & bit:
                    continue
                for s in range(found):
                    if masks[s] & bit:
                        points[used] = near[s]
                        used += 1
                places[count, 0], places[count, 1], places[count, 2] = start[0] + a, start[1] + b, start[2] + c
                count += 1
                first[count] = used
    return count
