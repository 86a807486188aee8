"""The relative neighborhood graph: two pores are joined unless a third is nearer to both than they are to each other.

It contains the Euclidean minimum spanning tree (G. T. Toussaint, The relative neighbourhood graph of a finite planar
set, Pattern Recognition 12, 1980): in the triangle of a longest edge and a pore that is nearer to both its ends the
other two edges do what it does. So the graph is connected, although each edge is decided by the pores around it. The
same holds for pores that repeat along periodic axes: an edge of the tree is never longer than any other image of it, so
that neither a third pore nor another image of its own ends can be nearer to both.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connecting.buckets import Buckets, bucket_along, sorted_into_buckets
from sppm_pipeline.method.connecting.trees import wrapped
from sppm_pipeline.services.arrays import F64, I8, I32
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import ordered_map

_CHUNK = 1 << 14
"""Pores that a thread works through at a time."""

_RADIUS, _GROWTH = 2.0, 1.4
"""Radius of the ball that is looked at first, in mean distances of pores, and what it grows by if it does not do. Of
1.85, 2 and 2.15 none is clearly faster for thrown pores, for which 2 nearly always does; for pores at random it does
9 times in 10. The growth factor only affects speed: each step searches the ball again."""

_FACETS = 4
"""The sphere of directions is cut into six times the square of this (3 is a little slower)."""

_NEAREST = 8
"""Pores of the ball that are sorted: the nearest hide most of the others. Only speed depends on it."""


def relative_neighbors(points: F64, period: F64, *, reach: float = np.inf, threads: int = 1) -> tuple[I32, I8]:
    """Edges (m, 2) of the relative neighborhood graph that are at most `reach` long, pairs i < j by i, and their turns.

    Turns (m, 3) are the periods by which the image of j is moved, after both were moved into [0, period): -1, 0 or 1.
    Of pores that are equally far from each other none is nearer, so that a regular lattice keeps all edges between
    neighbors. A pore is never joined to an image of itself.

    All pores in a ball are looked at, and the ball grows, up to `reach`, until they hide whatever may lie beyond it:
    pore c at the distance d hides all places beyond the radius r in directions less than arccos(d / 2r) away from its
    own. Beyond the border of the set there is nothing to be hidden: a pore there would look through the whole of a
    hollow set without a reach.
    """
    if len(points) < 2:
        return np.zeros((0, 2), np.int32), np.zeros((0, 3), np.int8)
    cells = sorted_into_buckets(wrapped(points, period)[0], period)
    places = cells.points[cells.order]
    facets, widest = _facets(_FACETS)
    # empty buckets say nothing about the distances of pores
    room = float(np.prod(cells.width)) * np.count_nonzero(np.diff(cells.start)) / len(points)
    radius = max(_RADIUS * room ** (1 / 3), 1e-150)

    def chunk(first: int) -> tuple[I32, I8]:
        stop = min(first + _CHUNK, len(points))
        return _relative_neighbors(cells, places, facets, widest, first, stop, radius, float(reach))

    found = list(ordered_map(chunk, range(0, len(points), _CHUNK), threads))
    return np.concatenate([edges for edges, _ in found]), np.concatenate([turns for _, turns in found])


def _facets(count: int) -> tuple[F64, float]:
    """Centers (f, 3) of 6 count^2 parts of the unit sphere, and the largest angle between a center and its part.

    The sides of a cube are cut at equal angles; each part is the spherical hull of its corners.
    """
    cut = np.tan(np.linspace(-np.pi / 4, np.pi / 4, 2 * count + 1))
    u, v = (grid.ravel() for grid in np.meshgrid(cut, cut, indexing="ij"))
    side = np.stack([np.ones_like(u), u, v], axis=1)
    side = (side / np.linalg.norm(side, axis=1, keepdims=True)).reshape(2 * count + 1, 2 * count + 1, 3)
    centers = side[1::2, 1::2]
    corners = np.stack([side[a : a + 2 * count : 2, b : b + 2 * count : 2] for a in (0, 2) for b in (0, 2)])
    widest = float(np.arccos(np.sum(corners * centers, axis=-1).min()))
    around = np.concatenate([np.roll(sense * centers, axis, axis=-1) for axis in range(3) for sense in (1, -1)])
    return np.ascontiguousarray(around.reshape(-1, 3)), widest


@jit
def _relative_neighbors(
    cells: Buckets, places: F64, facets: F64, widest: float, first: int, stop: int, start: float, reach: float
) -> tuple[I32, I8]:
    """Edges from the pores first <= i < stop to later ones, and their turns.

    `places` are the points by bucket; `facets` and `widest` are what `_facets` returns.
    """
    edges = np.empty((2 * (stop - first) + 64, 2), np.int32)
    turns = np.empty((len(edges), 3), np.int8)
    m = int(np.int64(0))
    # step x, y, z to each pore of the ball, and its square
    ball = np.empty((64, 4))
    # pore of each, and periods by which it is moved
    who = np.empty((64, 4), np.int32)
    hiders = np.empty((70, 4))
    for i in range(first, stop):
        radius = min(start, reach)
        # the ball grows until what lies beyond it can't matter; most pores need one step
        while True:
            count = _pores_within(cells, places, i, radius, ball, who)
            if count > len(ball):
                ball, who = np.empty((2 * count, 4)), np.empty((2 * count, 4), np.int32)
                hiders = np.empty((2 * count + 6, 4))
                continue
            _nearest_first(ball, who, count)
            if radius >= reach or _all_hidden(cells, i, radius, ball, count, facets, widest, hiders):
                break
            radius = min(_GROWTH * radius, reach)
        for c in range(count):
            if who[c, 0] > i and _none_nearer(c, ball, count):
                if m == len(edges):
                    edges = np.concatenate((edges, np.empty_like(edges)))
                    turns = np.concatenate((turns, np.empty_like(turns)))
                edges[m, 0], edges[m, 1] = i, who[c, 0]
                for a in range(3):
                    turns[m, a] = who[c, 1 + a]
                m += 1
    return edges[:m].copy(), turns[:m].copy()


@jit
def _pores_within(cells: Buckets, places: F64, i: int, radius: float, ball: F64, who: I32) -> int:
    """Write the pores at most `radius` away from i, and their images; returns how many there are, written or not."""
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    for a in range(3):
        # a little more, for images are moved with rounding
        below, above = cells.points[i, a] - 1.000000001 * radius, cells.points[i, a] + 1.000000001 * radius
        if cells.period[a] > 0:
            low[a] = np.int64(np.floor((below - cells.origin[a]) / cells.width[a]))
            high[a] = np.int64(np.floor((above - cells.origin[a]) / cells.width[a]))
        else:
            low[a] = bucket_along(below, cells.origin[a], cells.width[a], cells.shape[a])
            high[a] = bucket_along(above, cells.origin[a], cells.width[a], cells.shape[a])
    count = int(np.int64(0))
    nx, ny, nz = cells.shape
    for x in range(low[0], high[0] + 1):
        cx = _turns(x, nx)
        u0 = cx * cells.period[0] - cells.points[i, 0]
        for y in range(low[1], high[1] + 1):
            cy = _turns(y, ny)
            v0 = cy * cells.period[1] - cells.points[i, 1]
            column = ((x - cx * nx) * ny + y - cy * ny) * nz
            z = low[2]
            while z <= high[2]:
                # buckets that follow each other along z do so in memory, too
                cz = _turns(z, nz)
                end = min(high[2] + 1, (cz + 1) * nz)
                w0 = cz * cells.period[2] - cells.points[i, 2]
                for s in range(cells.start[column + z - cz * nz], cells.start[column + end - cz * nz]):
                    u, v, w = places[s, 0] + u0, places[s, 1] + v0, places[s, 2] + w0
                    square = u * u + v * v + w * w
                    if square <= radius * radius and (cells.order[s] != i or cx != 0 or cy != 0 or cz != 0):
                        if count < len(ball):
                            ball[count, 0], ball[count, 1], ball[count, 2], ball[count, 3] = u, v, w, square
                            who[count, 0], who[count, 1], who[count, 2], who[count, 3] = cells.order[s], cx, cy, cz
                        count += 1
                z = end
    return count


@jit
def _turns(index: int, count: int) -> int:
    """``index // count``; most indices lie inside the grid, and a division takes longer than all that is done there."""
    return index // count if index < 0 or index >= count else 0


@jit
def _nearest_first(ball: F64, who: I32, count: int) -> None:
    """Put the nearest pores first, sorted by distance; the order of the others is left open."""
    for c in range(1, count):
        d = c
        if c >= _NEAREST:
            if ball[c, 3] >= ball[_NEAREST - 1, 3]:
                continue
            d = _NEAREST - 1
            _swap(ball, who, c, d)
        while d > 0 and ball[d, 3] < ball[d - 1, 3]:
            _swap(ball, who, d, d - 1)
            d -= 1


@jit
def _swap(ball: F64, who: I32, c: int, d: int) -> None:
    for a in range(4):
        ball[c, a], ball[d, a] = ball[d, a], ball[c, a]
        who[c, a], who[d, a] = who[d, a], who[c, a]


@jit
def _all_hidden(
    cells: Buckets, i: int, radius: float, ball: F64, count: int, facets: F64, widest: float, hiders: F64
) -> bool:
    """True if for each place beyond the ball some pore in it is nearer to i and to the place than they are apart.

    A border of the set hides what lies beyond it as the mirror image of i would. Facets of the sphere of directions are
    looked at as a whole, so that the answer may be no although the truth is yes.
    """
    cosine, sine = np.cos(widest), np.sin(widest)
    most = int(np.int64(0))
    for a in range(3):
        offset = cells.points[i, a] - cells.origin[a]
        for sense in (-1.0, 1.0):
            least = max(offset if sense < 0 else cells.shape[a] * cells.width[a] - offset, 0.0) / radius
            if cells.period[a] > 0:
                # the image of i
                least = cells.period[a] / (2 * radius) if cells.period[a] < radius else 1.0
            if least < cosine:
                hiders[most, 0], hiders[most, 1], hiders[most, 2] = 0.0, 0.0, 0.0
                hiders[most, a] = sense
                most = _add_hider(hiders, most, least, cosine, sine)
    for c in range(min(count, _NEAREST)):
        most = _add_pore(hiders, most, ball, c, radius, cosine, sine)
    latest, added = int(np.int64(0)), min(count, _NEAREST)
    for f in range(len(facets)):
        u, v, w = facets[f, 0], facets[f, 1], facets[f, 2]
        # what hides a facet often hides the next one
        h = latest
        if h < most and u * hiders[h, 0] + v * hiders[h, 1] + w * hiders[h, 2] > hiders[h, 3]:
            continue
        h = 0
        while True:
            if h == most and added < count:
                most = _add_pore(hiders, most, ball, added, radius, cosine, sine)
                added += 1
            elif h == most:
                return False
            elif u * hiders[h, 0] + v * hiders[h, 1] + w * hiders[h, 2] > hiders[h, 3]:
                latest = h
                break
            else:
                h += 1
    return True


@jit
def _add_pore(hiders: F64, most: int, ball: F64, c: int, radius: float, cosine: float, sine: float) -> int:
    """Note what entry c of the ball hides; returns the new number of hiders."""
    distance = np.sqrt(ball[c, 3])
    if not 0 < distance < radius:
        return most
    for a in range(3):
        hiders[most, a] = ball[c, a] / distance
    return _add_hider(hiders, most, distance / (2 * radius), cosine, sine)


@jit
def _add_hider(hiders: F64, most: int, least: float, cosine: float, sine: float) -> int:
    """Note which facets are hidden if all directions with a component above `least` are; returns the new number.

    A facet whose center is at the angle t from the hider is if arccos(least) > t + widest; the margin covers rounding.
    """
    hiders[most, 3] = least * cosine + np.sqrt(1 - least * least) * sine + 1e-9
    return most + 1


@jit
def _none_nearer(c: int, ball: F64, count: int) -> bool:
    """True if no pore of the ball is nearer to both ends of the step to entry c."""
    square = ball[c, 3]
    for d in range(count):
        if ball[d, 3] < square:
            u, v, w = ball[d, 0] - ball[c, 0], ball[d, 1] - ball[c, 1], ball[d, 2] - ball[c, 2]
            if u * u + v * v + w * w < square:
                return False
    return True
