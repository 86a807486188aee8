"""Voronoi cells of a few seeds: their edges, and the distance from their walls.

An edge is found as the line on which two neighbors are as far away as the seed itself, clipped by the bisector planes
of all others that are near. Only seeds nearer than twice the distance of its furthest corner can cut a Voronoi cell, so
the edges are those of the whole, however many seeds there are further away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import jit
from sppm_structures.strut_kernels import BUCKETS, LEVELS, longer, place_of

_SAME = 1e-9
"""Lengths below this, in cell sizes, are none."""


class WallTable(NamedTuple):
    """Seeds (n, 3) of the cell and of its neighbors, sorted into buckets of the cell.

    The list of each bucket lies in `listed` (m,), from `begin` to `end` (BUCKETS^3,).
    """

    seeds: NDArray[np.float64]
    begin: NDArray[np.int64]
    end: NDArray[np.int64]
    listed: NDArray[np.int32]


def voronoi_edges(seeds: NDArray[np.float64], own: int, radius: float, most: float) -> NDArray[np.float64]:
    """Edges (m, 6), both ends, of the Voronoi cells of the first `own` seeds, each with one of the cells that share it.

    `seeds` (n, 3) are complete within the distance `most` of the first ones, the largest that is looked at; twice the
    largest distance that a point can have from the nearest seed is always enough. Those within `radius` are looked at
    first, more where they don't suffice. An edge belongs to the seed that comes first by x, then y, then z.
    """
    seeds = np.ascontiguousarray(seeds, np.float64)
    return _edges(seeds, int(own), float(radius), float(most))


def wall_table(seeds: NDArray[np.float64]) -> WallTable:
    """Sort seeds into buckets of the unit cube, so that each list holds all that matter to any point of its bucket."""
    seeds = np.ascontiguousarray(seeds, np.float64)
    return WallTable(seeds, *_list(seeds))


def evaluate_walls(
    table: WallTable, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Distance from the nearest face between two Voronoi cells, (nx, ny, nz) float32, cell sizes.

    Exact: a Voronoi cell is convex, so the distance from its boundary is that from the nearest of the planes that
    bound it; that between seeds a and b is at ``(|p - b|^2 - |p - a|^2) / (2 |b - a|)`` from a point p near a.
    """
    values = np.empty((len(z), len(y), len(x)), np.float32)
    _evaluate(table.seeds, table.begin, table.end, table.listed, x, y, z, values)
    return values.T


@jit
def _before(x: float, y: float, z: float) -> bool:
    """True if a seed at this place relative to another comes first, by x, then y, then z."""
    if abs(x) > _SAME:
        return x < 0.0
    if abs(y) > _SAME:
        return y < 0.0
    return z < 0.0


@jit
def _edges_of_one(
    near: NDArray[np.float64], half: NDArray[np.float64], limit: float, found: NDArray[np.float64]
) -> tuple[int, float]:
    """Edges (relative to the seed) that belong to the seed, and the furthest corner of its cell.

    `near` holds the other seeds relative to this one, nearest first; `half` the squares of their distances by two. No
    corner of the cell is known to lie further away than `limit`.
    """
    count, furthest = 0, 0.0
    n = len(near)
    for j in range(n):
        for k in range(j + 1, n):
            ux = near[j, 1] * near[k, 2] - near[j, 2] * near[k, 1]
            uy = near[j, 2] * near[k, 0] - near[j, 0] * near[k, 2]
            uz = near[j, 0] * near[k, 1] - near[j, 1] * near[k, 0]
            across = ux * ux + uy * uy + uz * uz
            # parallel planes have no line in common
            if across <= 1e-18 * half[j] * half[k]:
                continue
            # the point of both planes nearest to the seed: a of one normal and b of the other
            dot = near[j, 0] * near[k, 0] + near[j, 1] * near[k, 1] + near[j, 2] * near[k, 2]
            a = (half[j] * 2.0 * half[k] - half[k] * dot) / across
            b = (half[k] * 2.0 * half[j] - half[j] * dot) / across
            qx = a * near[j, 0] + b * near[k, 0]
            qy = a * near[j, 1] + b * near[k, 1]
            qz = a * near[j, 2] + b * near[k, 2]
            if qx * qx + qy * qy + qz * qz > limit * limit:
                continue
            scale = 1.0 / np.sqrt(across)
            ux, uy, uz = ux * scale, uy * scale, uz * scale
            low, high = -1e6, 1e6
            own = not (_before(near[j, 0], near[j, 1], near[j, 2]) or _before(near[k, 0], near[k, 1], near[k, 2]))
            for m in range(n):
                if m in (j, k):
                    continue
                slope = ux * near[m, 0] + uy * near[m, 1] + uz * near[m, 2]
                room = half[m] - (qx * near[m, 0] + qy * near[m, 1] + qz * near[m, 2])
                size = np.sqrt(2.0 * half[m])
                if abs(slope) <= _SAME * size:
                    if room < -_SAME * size:
                        high = low
                        break
                    if room < _SAME * size and _before(near[m, 0], near[m, 1], near[m, 2]):
                        own = False  # four and more cells share the edge
                elif slope > 0.0:
                    high = min(high, room / slope)
                else:
                    low = max(low, room / slope)
                if high - low <= _SAME:
                    break
            if high - low <= _SAME:
                continue
            square = qx * qx + qy * qy + qz * qz
            furthest = max(furthest, square + max(low * low, high * high))
            if not own:
                continue
            ends = (qx + low * ux, qy + low * uy, qz + low * uz, qx + high * ux, qy + high * uy, qz + high * uz)
            twin = False
            for e in range(count):
                straight, turned = 0.0, 0.0
                for c in range(6):
                    straight = max(straight, abs(found[e, c] - ends[c]))
                    turned = max(turned, abs(found[e, c] - ends[(c + 3) % 6]))
                twin = twin or min(straight, turned) < 1e-7
            if not twin and count < len(found):
                for c in range(6):
                    found[count, c] = ends[c]
                count += 1
    return count, np.sqrt(furthest)


@jit
def _edges(seeds: NDArray[np.float64], own: int, radius: float, most: float) -> NDArray[np.float64]:
    found = np.empty((4096, 6))
    kept = np.empty((own * 32 + 64, 6))
    total = 0
    for s in range(own):
        reach, limit = min(radius, most), 0.5 * most + _SAME
        while True:
            squares = np.empty(len(seeds))
            count = 0
            for m in range(len(seeds)):
                squares[m] = (
                    (seeds[m, 0] - seeds[s, 0]) ** 2
                    + (seeds[m, 1] - seeds[s, 1]) ** 2
                    + (seeds[m, 2] - seeds[s, 2]) ** 2
                )
                if m != s and squares[m] <= reach * reach:
                    count += 1
            which = np.empty(count, np.int64)
            at = 0
            for m in range(len(seeds)):
                if m != s and squares[m] <= reach * reach:
                    which[at] = m
                    at += 1
            which = which[np.argsort(squares[which], kind="mergesort")]
            near = np.empty((count, 3))
            half = np.empty(count)
            for m in range(count):
                for c in range(3):
                    near[m, c] = seeds[which[m], c] - seeds[s, c]
                half[m] = 0.5 * squares[which[m]]
            edges, furthest = _edges_of_one(near, half, limit, found)
            if (furthest > 0.0 and 2.0 * furthest <= reach) or reach >= most:
                break
            # a seed nearer than twice the furthest corner was left out; an open cell has corners without end
            limit = min(limit, furthest + _SAME) if furthest > 0.0 else limit
            reach = min(most, max(1.3 * reach, min(2.0 * furthest, 2.0 * reach)))
        if total + edges > len(kept):
            longer = np.empty((2 * (total + edges), 6))
            for e in range(total):
                for c in range(6):
                    longer[e, c] = kept[e, c]
            kept = longer
        for e in range(edges):
            for c in range(6):
                kept[total, c] = found[e, c] + seeds[s, c % 3]
            total += 1
    return kept[:total].copy()


@jit
def _limit(
    seeds: NDArray[np.float64],
    near: NDArray[np.int64],
    level: int,
    count: int,
    x: float,
    y: float,
    z: float,
    distances: NDArray[np.float64],
) -> float:
    """Distance of the nearest seed plus twice that of the nearest wall; leaves the distances of the seeds listed."""
    nearest = near[level, 0]
    for at in range(count):
        s = near[level, at]
        distances[s] = np.sqrt((seeds[s, 0] - x) ** 2 + (seeds[s, 1] - y) ** 2 + (seeds[s, 2] - z) ** 2)
        if distances[s] < distances[nearest]:
            nearest = s
    wall = np.inf
    for at in range(count):
        s = near[level, at]
        if s != nearest and distances[s] < distances[nearest] + 2.0 * wall:
            apart = np.sqrt(
                (seeds[s, 0] - seeds[nearest, 0]) ** 2
                + (seeds[s, 1] - seeds[nearest, 1]) ** 2
                + (seeds[s, 2] - seeds[nearest, 2]) ** 2
            )
            wall = min(wall, (distances[s] ** 2 - distances[nearest] ** 2) / (2.0 * apart))
    limit: float = distances[nearest] + 2.0 * wall + 1e-12
    return limit


@jit
def _list(seeds: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    """The seeds of each bucket: where its list begins and ends; octants first, as for struts.

    The distance W from the walls changes by no more than the distance moved. With h from the center c of a bucket to
    its corners, W < W(c) + h in it; and a seed b can bound the cell of a seed a at p nearer than W only if it is nearer
    than ``|p - a| + 2 W``.
    """
    begin, end = np.empty(BUCKETS**3, np.int64), np.empty(BUCKETS**3, np.int64)
    listed = np.empty(32 * BUCKETS**3, np.int32)
    total = 0
    distances = np.empty(len(seeds))
    near = np.empty((LEVELS + 1, len(seeds)), np.int64)
    count = np.zeros(LEVELS + 1, np.int64)
    for s in range(len(seeds)):
        near[LEVELS, s] = s
    count[LEVELS] = len(seeds)
    for morton in range(BUCKETS**3):
        for level in range(LEVELS - 1, -1, -1):
            if morton % (1 << (3 * level)) != 0:
                continue
            i, j, k = place_of(morton, level)
            half = 0.5 * (1 << level)
            x, y, z = (i + half) / BUCKETS, (j + half) / BUCKETS, (k + half) / BUCKETS
            limit = _limit(seeds, near, level + 1, count[level + 1], x, y, z, distances)
            # W and both distances change by half a diagonal at most: once for p, once for b, twice for W
            limit += 4.0 * np.sqrt(3.0) * half / BUCKETS
            count[level] = 0
            for at in range(count[level + 1]):
                s = near[level + 1, at]
                if distances[s] <= limit:
                    near[level, count[level]] = s
                    count[level] += 1
        i, j, k = place_of(morton, 0)
        bucket = (k * BUCKETS + j) * BUCKETS + i
        if total + count[0] > len(listed):
            listed = longer(listed, total + count[0])
        begin[bucket] = total
        for at in range(count[0]):
            listed[total + at] = near[0, at]
        total += count[0]
        end[bucket] = total
    return begin, end, listed[:total].copy()


@jit
def _evaluate(
    seeds: NDArray[np.float64],
    begin: NDArray[np.int64],
    end: NDArray[np.int64],
    listed: NDArray[np.int32],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    values: NDArray[np.float32],
) -> None:
    squares = np.empty(len(seeds))
    for k in range(len(z)):
        bz = int(z[k] * BUCKETS)
        for j in range(len(y)):
            by = int(y[j] * BUCKETS)
            for i in range(len(x)):
                bucket = (bz * BUCKETS + by) * BUCKETS + int(x[i] * BUCKETS)
                start, count = begin[bucket], end[bucket] - begin[bucket]
                nearest = 0
                for at in range(count):
                    s = listed[start + at]
                    squares[at] = (seeds[s, 0] - x[i]) ** 2 + (seeds[s, 1] - y[j]) ** 2 + (seeds[s, 2] - z[k]) ** 2
                    if squares[at] < squares[nearest]:
                        nearest = at
                a = listed[start + nearest]
                best = np.inf  # of the squares of twice the distances
                for at in range(count):
                    if at == nearest:
                        continue
                    b = listed[start + at]
                    apart = (
                        (seeds[b, 0] - seeds[a, 0]) ** 2
                        + (seeds[b, 1] - seeds[a, 1]) ** 2
                        + (seeds[b, 2] - seeds[a, 2]) ** 2
                    )
                    further = squares[at] - squares[nearest]
                    if further * further < best * apart:
                        best = further * further / apart
                values[k, j, i] = np.float32(0.5 * np.sqrt(best))
