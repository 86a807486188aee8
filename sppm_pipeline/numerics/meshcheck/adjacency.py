"""Who meets whom in a triangle mesh: triangles across edges, corners around vertices, rims of holes.

Half-edge 3 f + c runs from corner c of triangle f to the next corner. Two half-edges of one edge are *mates* if no
third one shares the edge; whether they run against each other, as they should, is not asked here. The corners of the
triangles that a walk across mates reaches around a vertex make a *fan*; a vertex with two fans is not manifold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

RIM = -1
"""Mate of a half-edge whose edge no other triangle shares."""

CROWDED = -2
"""Mate of a half-edge whose edge three or more triangles share."""


class Adjacency(NamedTuple):
    """What `adjacency` finds.

    Attributes
    ----------
    mates : (3 m,) int64
        The other half-edge of the edge; `RIM` or `CROWDED` if there is no single one.
    fans : (3 m,) int64
        The fan of each corner, numbered from 0 in the order of their first corners.
    fan_count : int
    surfaces : (m,) int64
        The surface of each triangle, that is, what a walk across mates reaches, numbered likewise.
    surface_count : int
    split_vertices : int
        Vertices with more than one fan: surfaces touch there, in the vertex alone or along a crowded edge.
    """

    mates: NDArray[np.int64]
    fans: NDArray[np.int64]
    fan_count: int
    surfaces: NDArray[np.int64]
    surface_count: int
    split_vertices: int


class Rims(NamedTuple):
    """The rims of the holes, each a closed line of edges; a rim that touches itself is cut apart there.

    Attributes
    ----------
    edges : (k,) int64
        Number of edges of each rim.
    lengths, sizes : (k,) float64
        Length along the rim, and diagonal of the box around it.
    """

    edges: NDArray[np.int64]
    lengths: NDArray[np.float64]
    sizes: NDArray[np.float64]


def adjacency(faces: NDArray[np.integer]) -> Adjacency:
    """Find mates and fans of triangles (m, 3); vertex numbers are from 0 to 2^31 - 1.

    An edge from a vertex to itself, which a triangle has that names a vertex twice, is crowded.
    """
    triangles = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    if triangles.size == 0:
        nothing = np.empty(0, np.int64)
        return Adjacency(nothing, nothing, 0, nothing, 0, 0)
    ahead = np.roll(triangles, -1, axis=1)
    n = int(triangles.max()) + 1
    keys = (np.minimum(triangles, ahead) * n + np.maximum(triangles, ahead)).ravel()
    order = np.argsort(keys, kind="stable")
    mates = _mates(keys, order, triangles)
    fans, count, split = _fans(triangles, mates, n)
    surfaces, surface_count = _surfaces(mates)
    return Adjacency(mates, fans, int(count), surfaces, int(surface_count), int(split))


def rims(vertices: NDArray[np.float64], faces: NDArray[np.integer], found: Adjacency) -> Rims:
    """The rims of the holes of a mesh, the one with the longest way around first."""
    triangles = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    half_edges = np.flatnonzero(found.mates == RIM)
    if half_edges.size == 0:
        return Rims(np.empty(0, np.int64), np.empty(0), np.empty(0))
    labels, count = _rims(half_edges, found.fans, found.fan_count)
    ahead = half_edges - half_edges % 3 + (half_edges + 1) % 3
    points = np.asarray(vertices, np.float64)
    starts, ends = points[triangles.ravel()[half_edges]], points[triangles.ravel()[ahead]]
    edges = np.bincount(labels, minlength=count)
    lengths = np.asarray(np.bincount(labels, np.linalg.norm(ends - starts, axis=1), count), np.float64)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for side in (starts, ends):
        np.minimum.at(low, labels, side)
        np.maximum.at(high, labels, side)
    longest = np.argsort(-lengths, kind="stable")
    return Rims(edges[longest], lengths[longest], np.linalg.norm(high - low, axis=1)[longest])


@jit
def _mates(keys: NDArray[np.int64], order: NDArray[np.int64], faces: NDArray[np.int64]) -> NDArray[np.int64]:
    mates = np.full(keys.size, -1, np.int64)
    i = 0
    while i < order.size:
        j = i + 1
        while j < order.size and keys[order[j]] == keys[order[i]]:
            j += 1
        h = order[i]
        loop = faces[h // 3, h % 3] == faces[h // 3, (h + 1) % 3]
        if loop or j - i > 2:
            for k in range(i, j):
                mates[order[k]] = -2
        elif j - i == 2:
            mates[order[i]] = order[i + 1]
            mates[order[i + 1]] = order[i]
        i = j
    return mates


@jit
def _root(parent: NDArray[np.int64], a: int) -> int:
    while parent[a] != a:
        parent[a] = parent[parent[a]]
        a = parent[a]
    return a


@jit
def _join(parent: NDArray[np.int64], a: int, b: int) -> None:
    """The smaller root wins, so that the numbering does not depend on how it went."""
    a, b = _root(parent, a), _root(parent, b)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b


@jit
def _number(parent: NDArray[np.int64]) -> int:
    """Replace each parent by the number of its set; a root is the smallest member, so it is met first."""
    count = 0
    for i in range(parent.size):
        if parent[i] == i:
            parent[i] = count
            count += 1
        else:
            parent[i] = parent[parent[i]]
    return count


@jit
def _fans(faces: NDArray[np.int64], mates: NDArray[np.int64], n: int) -> tuple[NDArray[np.int64], int, int]:
    parent = np.arange(mates.size)
    for h in range(mates.size):
        g = mates[h]
        if g < h:
            continue
        h_next, g_next = h - h % 3 + (h + 1) % 3, g - g % 3 + (g + 1) % 3
        if faces[h // 3, h % 3] == faces[g // 3, g % 3]:
            _join(parent, h, g)
            _join(parent, h_next, g_next)
        else:
            _join(parent, h, g_next)
            _join(parent, h_next, g)
    for i in range(parent.size):
        parent[i] = _root(parent, i)
    count = _number(parent)
    first = np.full(n, -1, np.int64)
    split = np.zeros(n, np.bool_)
    for i in range(parent.size):
        vertex = faces[i // 3, i % 3]
        if first[vertex] < 0:
            first[vertex] = parent[i]
        elif first[vertex] != parent[i]:
            split[vertex] = True
    return parent, count, split.sum()


@jit
def _surfaces(mates: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    parent = np.arange(mates.size // 3)
    for h in range(mates.size):
        if mates[h] > h:
            _join(parent, h // 3, mates[h] // 3)
    for i in range(parent.size):
        parent[i] = _root(parent, i)
    return parent, _number(parent)


@jit
def _rims(half_edges: NDArray[np.int64], fans: NDArray[np.int64], fan_count: int) -> tuple[NDArray[np.int64], int]:
    """The rim of each half-edge; the rim of an open fan goes on where it ends."""
    last = np.full(fan_count, -1, np.int64)
    parent = np.arange(half_edges.size)
    for i in range(half_edges.size):
        h = half_edges[i]
        for corner in (h, h - h % 3 + (h + 1) % 3):
            fan = fans[corner]
            if last[fan] >= 0:
                _join(parent, i, last[fan])
            last[fan] = i
    for i in range(parent.size):
        parent[i] = _root(parent, i)
    return parent, _number(parent)
