"""Adjacency of a triangle mesh: opposite half-edges, vertex fans, connected surfaces, boundary loops.

Half-edge 3 f + c runs from corner c of triangle f to the next corner. Two half-edges of one edge are *opposite* if no
third one shares the edge; whether they run against each other, as they should, is not asked here. The corners around a
vertex that are connected across opposite half-edges make a *vertex fan*; a vertex with two fans is non-manifold.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root, unite

BOUNDARY = -1
"""In place of an opposite half-edge: no other triangle shares the edge."""

NON_MANIFOLD = -2
"""In place of an opposite half-edge: three or more triangles share the edge."""


class Adjacency(NamedTuple):
    """The result of `adjacency`."""

    opposite: I64  # (3 m,): the other half-edge; `BOUNDARY` or `NON_MANIFOLD` if there is no single one
    fans: I64  # (3 m,), of each corner, numbered from 0 in the order of their first corners
    fan_count: int
    surfaces: I64  # (m,), what is connected across opposite half-edges, numbered likewise
    surface_count: int
    non_manifold_vertices: int  # those with several fans: surfaces touch in the vertex, or along a non-manifold edge


class BoundaryLoops(NamedTuple):
    """The boundaries of the holes, each a closed loop of edges; a loop that touches itself is split there."""

    edges: I64  # number of edges of each loop
    lengths: F64
    sizes: F64  # diagonals of their bounding boxes


def adjacency(faces: NDArray[np.integer]) -> Adjacency:
    """Opposite half-edges and vertex fans of triangles (m, 3); vertex numbers are from 0 to 2^31 - 1.

    An edge from a vertex to itself, as of a triangle that names a vertex twice, counts as non-manifold.
    """
    triangles = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    if triangles.size == 0:
        nothing = np.empty(0, np.int64)
        return Adjacency(nothing, nothing, 0, nothing, 0, 0)
    ahead = np.roll(triangles, -1, axis=1)
    n = int(triangles.max()) + 1
    keys = (np.minimum(triangles, ahead) * n + np.maximum(triangles, ahead)).ravel()
    order = np.argsort(keys, kind="stable")
    opposite = _opposite(keys, order, triangles)
    fans, count, split = _fans(triangles, opposite, n)
    surfaces, surface_count = _surfaces(opposite)
    return Adjacency(opposite, fans, int(count), surfaces, int(surface_count), int(split))


def boundary_loops(vertices: F64, faces: NDArray[np.integer], found: Adjacency) -> BoundaryLoops:
    """The boundary loops of a mesh, the longest first."""
    triangles = np.ascontiguousarray(faces, np.int64).reshape(-1, 3)
    half_edges = np.flatnonzero(found.opposite == BOUNDARY)
    if half_edges.size == 0:
        return BoundaryLoops(np.empty(0, np.int64), np.empty(0), np.empty(0))
    labels, count = _boundary_loops(half_edges, found.fans, found.fan_count)
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
    return BoundaryLoops(edges[longest], lengths[longest], np.linalg.norm(high - low, axis=1)[longest])


@jit
def _opposite(keys: I64, order: I64, faces: I64) -> I64:
    opposite = np.full(keys.size, -1, np.int64)
    i = 0
    while i < order.size:
        j = i + 1
        while j < order.size and keys[order[j]] == keys[order[i]]:
            j += 1
        h = order[i]
        loop = faces[h // 3, h % 3] == faces[h // 3, (h + 1) % 3]
        if loop or j - i > 2:
            for k in range(i, j):
                opposite[order[k]] = -2
        elif j - i == 2:
            opposite[order[i]] = order[i + 1]
            opposite[order[i + 1]] = order[i]
        i = j
    return opposite


@jit
def _number(parent: I64) -> int:
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
def _fans(faces: I64, opposite: I64, n: int) -> tuple[I64, int, int]:
    parent = np.arange(opposite.size)
    for h in range(opposite.size):
        g = opposite[h]
        if g < h:
            continue
        h_next, g_next = h - h % 3 + (h + 1) % 3, g - g % 3 + (g + 1) % 3
        if faces[h // 3, h % 3] == faces[g // 3, g % 3]:
            unite(parent, h, g)
            unite(parent, h_next, g_next)
        else:
            unite(parent, h, g_next)
            unite(parent, h_next, g)
    for i in range(parent.size):
        parent[i] = find_root(parent, i)
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
def _surfaces(opposite: I64) -> tuple[I64, int]:
    parent = np.arange(opposite.size // 3)
    for h in range(opposite.size):
        if opposite[h] > h:
            unite(parent, h // 3, opposite[h] // 3)
    for i in range(parent.size):
        parent[i] = find_root(parent, i)
    return parent, _number(parent)


@jit
def _boundary_loops(half_edges: I64, fans: I64, fan_count: int) -> tuple[I64, int]:
    """The loop of each boundary half-edge; it continues at the other end of an open vertex fan."""
    last = np.full(fan_count, -1, np.int64)
    parent = np.arange(half_edges.size)
    for i in range(half_edges.size):
        h = half_edges[i]
        for corner in (h, h - h % 3 + (h + 1) % 3):
            fan = fans[corner]
            if last[fan] >= 0:
                unite(parent, i, last[fan])
            last[fan] = i
    for i in range(parent.size):
        parent[i] = find_root(parent, i)
    return parent, _number(parent)
