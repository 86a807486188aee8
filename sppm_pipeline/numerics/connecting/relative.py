"""The relative neighborhood graph: two pores are joined unless a third is nearer to both than they are to each other.

It contains the Euclidean minimum spanning tree (G. T. Toussaint, The relative neighbourhood graph of a finite planar
set, Pattern Recognition 12, 1980): in the triangle of a longest edge and a pore that is nearer to both its ends the
other two edges do what it does. So the graph is connected, although each edge is decided by the pores around it. The
same holds for pores that repeat along periodic axes: an edge of the tree is never longer than any other image of it, so
that neither a third pore nor another image of its own ends can be nearer to both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connecting.buckets import (
    Buckets,
    bucket_along,
    bucket_of,
    last_ring,
    ring_distance,
    sorted_into_buckets,
    wrapped_bucket,
)
from sppm_pipeline.numerics.connecting.trees import wrapped
from sppm_pipeline.numerics.threads import ordered_map

_CHUNK = 1 << 14
"""Pores that a thread works through at a time."""


def relative_neighbors(
    points: NDArray[np.float64], period: NDArray[np.float64], *, reach: float = np.inf, threads: int = 1
) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Edges of the relative neighborhood graph, of those that are at most `reach` long.

    Of pores that are equally far from each other none is nearer, so that a regular lattice keeps all edges between
    neighbors. A pore is never joined to an image of itself.

    Parameters
    ----------
    points : (n, 3) float64
        Pore centers.
    period : (3,) float64
        Whole cells after which each axis repeats, 0 for never.
    reach : float
        The search ends there. Without it a pore at the border of a hollow set looks through the whole hollow.
    threads : int
        Changes nothing but the time.

    Returns
    -------
    edges : (m, 2) int32
        Pairs i < j, by i.
    turns : (m, 3) int8
        Periods by which the image of j is moved, after both were moved into [0, period): -1, 0 or 1.
    """
    if len(points) < 2:
        return np.zeros((0, 2), np.int32), np.zeros((0, 3), np.int8)
    cells = sorted_into_buckets(wrapped(points, period)[0], period)

    def chunk(first: int) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
        return _relative_neighbors(cells, first, min(first + _CHUNK, len(points)), float(reach))

    found = list(ordered_map(chunk, range(0, len(points), _CHUNK), threads))
    return np.concatenate([edges for edges, _ in found]), np.concatenate([turns for _, turns in found])


@jit
def _relative_neighbors(
    cells: Buckets, first: int, stop: int, reach: float
) -> tuple[NDArray[np.int32], NDArray[np.int8]]:
    """Edges from the pores first <= i < stop to later ones, and their turns."""
    edges = np.empty((4 * (stop - first) + 64, 2), np.int32)
    turns = np.empty((len(edges), 3), np.int8)
    m = int(np.int64(0))
    here = np.zeros(3, np.int64)
    turn = np.zeros(3, np.int64)
    steps = np.empty((64, 3))
    squares = np.empty(64)
    who = np.empty(64, np.int64)
    how = np.empty((64, 3), np.int64)
    # halving a box as often as it can be leaves one more waiting each time
    boxes = np.empty((6 + 3 * 64, 6), np.int64)
    low = np.empty(3)
    for i in range(first, stop):
        bucket_of(cells, i, here)
        for a in range(3):
            low[a] = cells.origin[a] + here[a] * cells.width[a] - cells.points[i, a]
        count = int(np.int64(0))
        for ring in range(last_ring(cells, here) + 1):
            if ring_distance(cells, here, i, ring) > reach:
                break
            if ring > 1:
                _sort(steps, squares, who, how, count)
            closed = ring > 1
            pending = _push_sides(cells, here, ring, boxes)
            while pending > 0:
                pending -= 1
                x0, x1, y0 = boxes[pending, 0], boxes[pending, 1], boxes[pending, 2]
                y1, z0, z1 = boxes[pending, 3], boxes[pending, 4], boxes[pending, 5]
                if ring > 1:
                    if _hidden(low, cells.width, x0, x1, y0, y1, z0, z1, steps, squares, count):
                        continue
                    if x0 < x1 or y0 < y1 or z0 < z1:
                        pending = _push_halves(boxes, pending, x0, x1, y0, y1, z0, z1)
                        continue
                closed = False
                for x in range(x0, x1 + 1):
                    for y in range(y0, y1 + 1):
                        for z in range(z0, z1 + 1):
                            bucket = wrapped_bucket(cells, here, x, y, z, turn)
                            for s in range(cells.start[bucket], cells.start[bucket + 1]):
                                if count == len(who):
                                    steps, squares, who, how = _doubled(steps, squares, who, how)
                                count = _seen(cells, i, cells.order[s], turn, reach, steps, squares, who, how, count)
            if closed:
                break
        for c in range(count):
            if who[c] > i and _none_nearer(c, steps, squares, count) and _empty_lune(cells, i, steps[c], squares[c]):
                if m == len(edges):
                    edges = np.concatenate((edges, np.empty_like(edges)))
                    turns = np.concatenate((turns, np.empty_like(turns)))
                edges[m, 0], edges[m, 1] = i, who[c]
                for a in range(3):
                    turns[m, a] = np.sign(how[c, a])
                m += 1
    return edges[:m].copy(), turns[:m].copy()


@jit
def _doubled(
    steps: NDArray[np.float64], squares: NDArray[np.float64], who: NDArray[np.int64], how: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """The same lists with room for twice as many pores."""
    return (
        np.concatenate((steps, steps)),
        np.concatenate((squares, squares)),
        np.concatenate((who, who)),
        np.concatenate((how, how)),
    )


@jit
def _push_sides(cells: Buckets, here: NDArray[np.int64], ring: int, boxes: NDArray[np.int64]) -> int:
    """Write the six sides of a ring, as far as there are buckets, as first and last steps along x, y, z, (sides, 6)."""
    sides = int(np.int64(0))
    for axis in range(3):
        for sense in (-1, 1):
            if ring == 0 and (axis > 0 or sense > 0):
                continue
            empty = False
            for a in range(3):
                # the sides across later axes leave out what belongs to those across earlier ones
                span = ring - 1 if a < axis else ring
                low = sense * ring if a == axis else -span
                high = sense * ring if a == axis else span
                first, last = -here[a], cells.shape[a] - 1 - here[a]
                if cells.period[a] > 0:
                    first, last = -cells.shape[a] - 1, cells.shape[a] + 1
                boxes[sides, 2 * a], boxes[sides, 2 * a + 1] = max(low, first), min(high, last)
                empty |= boxes[sides, 2 * a] > boxes[sides, 2 * a + 1]
            sides += not empty
    return sides


@jit
def _push_halves(boxes: NDArray[np.int64], pending: int, x0: int, x1: int, y0: int, y1: int, z0: int, z1: int) -> int:
    """Write the halves of a box, cut across where it has the most buckets; returns the new number of boxes."""
    for row in (pending, pending + 1):
        boxes[row, 0], boxes[row, 1], boxes[row, 2], boxes[row, 3], boxes[row, 4], boxes[row, 5] = (
            x0,
            x1,
            y0,
            y1,
            z0,
            z1,
        )
    wide = 0 if x1 - x0 >= y1 - y0 and x1 - x0 >= z1 - z0 else 2 if y1 - y0 >= z1 - z0 else 4
    middle = (boxes[pending, wide] + boxes[pending, wide + 1]) // 2
    boxes[pending, wide + 1] = middle
    boxes[pending + 1, wide] = middle + 1
    return pending + 2


@jit
def _sort(
    steps: NDArray[np.float64], squares: NDArray[np.float64], who: NDArray[np.int64], how: NDArray[np.int64], count: int
) -> None:
    """Put the nearest first: they hide most."""
    for c in range(1, count):
        d = c
        while d > 0 and squares[d] < squares[d - 1]:
            squares[d], squares[d - 1] = squares[d - 1], squares[d]
            who[d], who[d - 1] = who[d - 1], who[d]
            for a in range(3):
                steps[d, a], steps[d - 1, a] = steps[d - 1, a], steps[d, a]
                how[d, a], how[d - 1, a] = how[d - 1, a], how[d, a]
            d -= 1


@jit
def _hidden(
    low: NDArray[np.float64],
    width: NDArray[np.float64],
    x0: int,
    x1: int,
    y0: int,
    y1: int,
    z0: int,
    z1: int,
    steps: NDArray[np.float64],
    squares: NDArray[np.float64],
    count: int,
) -> bool:
    """Whether some pore found before is nearer to i and to each place in a box of buckets than that place is to i.

    Then so is all that lies behind the box, seen from i: a ring of hidden boxes ends the search. `low` is the step from
    i to the low corner of its bucket.
    """
    u0, v0, w0 = low[0] + x0 * width[0], low[1] + y0 * width[1], low[2] + z0 * width[2]
    u1, v1, w1 = low[0] + (x1 + 1) * width[0], low[1] + (y1 + 1) * width[1], low[2] + (z1 + 1) * width[2]
    apart = max(u0, -u1, 0.0) ** 2 + max(v0, -v1, 0.0) ** 2 + max(w0, -w1, 0.0) ** 2
    for c in range(count):
        # those that are left are farther than the box, but for the few that were found since they were sorted
        if 1.000000001 * squares[c] >= apart:
            break
        u, v, w = steps[c, 0], steps[c, 1], steps[c, 2]
        # least component along the step to the pore; the margins keep what only rounding would hide
        along = min(u0 * u, u1 * u) + min(v0 * v, v1 * v) + min(w0 * w, w1 * w)
        if along > 0.500000001 * squares[c]:
            return True
    return False


@jit
def _seen(
    cells: Buckets,
    i: int,
    j: int,
    turn: NDArray[np.int64],
    reach: float,
    steps: NDArray[np.float64],
    squares: NDArray[np.float64],
    who: NDArray[np.int64],
    how: NDArray[np.int64],
    count: int,
) -> int:
    """Add j to the list of pores around i, unless one of the list hides it; returns the length of the list."""
    square = 0.0
    for a in range(3):
        steps[count, a] = cells.points[j, a] + turn[a] - cells.points[i, a]
        square += steps[count, a] ** 2
    if (i == j and turn[0] == 0 and turn[1] == 0 and turn[2] == 0) or square > reach * reach:
        return count
    for c in range(count):
        if squares[c] < square:
            apart = 0.0
            for a in range(3):
                apart += (steps[count, a] - steps[c, a]) ** 2
            if apart < square:
                return count
    squares[count] = square
    who[count] = j
    for a in range(3):
        how[count, a] = turn[a]
    return count + 1


@jit
def _none_nearer(c: int, steps: NDArray[np.float64], squares: NDArray[np.float64], count: int) -> bool:
    """Whether no pore of the list is nearer to both ends of the step to entry c: most pores fail here already."""
    for d in range(count):
        if squares[d] < squares[c]:
            apart = 0.0
            for a in range(3):
                apart += (steps[d, a] - steps[c, a]) ** 2
            if apart < squares[c]:
                return False
    return True


@jit
def _empty_lune(cells: Buckets, i: int, step: NDArray[np.float64], square: float) -> bool:
    """Whether no pore is nearer to i and to the place `step` away from it than they are to each other."""
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    # half the height of the lune
    reach = np.sqrt(0.75 * square)
    for a in range(3):
        middle = cells.points[i, a] + 0.5 * step[a]
        # along an axis the lune is no wider than its ball, nor than the common part of the two balls
        low = max(middle - reach, cells.points[i, a] + max(step[a], 0.0) - np.sqrt(square))
        high = min(middle + reach, cells.points[i, a] + min(step[a], 0.0) + np.sqrt(square))
        if cells.period[a] > 0:
            first[a] = np.int64(np.floor((low - cells.origin[a]) / cells.width[a]))
            last[a] = np.int64(np.floor((high - cells.origin[a]) / cells.width[a]))
        else:
            first[a] = bucket_along(low, cells.origin[a], cells.width[a], cells.shape[a])
            last[a] = bucket_along(high, cells.origin[a], cells.width[a], cells.shape[a])
    for x in range(first[0], last[0] + 1):
        cx = _turns(x, cells.shape[0])
        for y in range(first[1], last[1] + 1):
            cy = _turns(y, cells.shape[1])
            column = ((x - cx * cells.shape[0]) * cells.shape[1] + y - cy * cells.shape[1]) * cells.shape[2]
            for z in range(first[2], last[2] + 1):
                cz = _turns(z, cells.shape[2])
                bucket = column + z - cz * cells.shape[2]
                for s in range(cells.start[bucket], cells.start[bucket + 1]):
                    k = cells.order[s]
                    u = cells.points[k, 0] + cx * cells.period[0] - cells.points[i, 0]
                    v = cells.points[k, 1] + cy * cells.period[1] - cells.points[i, 1]
                    w = cells.points[k, 2] + cz * cells.period[2] - cells.points[i, 2]
                    if u * u + v * v + w * w < square:
                        u, v, w = u - step[0], v - step[1], w - step[2]
                        if u * u + v * v + w * w < square:
                            return False
    return True


@jit
def _turns(index: int, count: int) -> int:
    """``index // count``; most indices lie inside the grid, and a division takes longer than all that is done there."""
    return index // count if index < 0 or index >= count else 0
