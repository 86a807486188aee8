"""Graphs among periodic images: canonical edges and their lengths, minimum spanning trees, components and bridges.

Trees are found by Prim over all pairs, or by Kruskal with union-find over given edges; bridges, the edges whose loss
would cut a graph in two, by Tarjan's low-link search.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.metric import lengths_in
from sppm_pipeline.services.union_find import find_root, unite


def as_points(points: ArrayLike) -> F64:
    """The points as a C-contiguous (n, 3) float64 array."""
    return np.ascontiguousarray(points, dtype=np.float64)


Indices = NDArray[np.integer]
"""Edges (m, 2) as pairs of pore indices, or their shifts (m, 3); large graphs hold them in fewer than 64 bits."""

Periodic = bool | Sequence[float]
"""True if all axes repeat with period 1, else the period of each in whole cells, 0 for none."""


def periods(periodic: Periodic) -> F64:
    """Whole cells after which x, y, z repeat, (3,) float64, 0 for never."""
    period = np.asarray(periodic, dtype=np.float64)
    return np.ascontiguousarray(np.broadcast_to(period, 3))


def images_per_pair(periodic: Periodic) -> int:
    """Number of tunnels that two pores may always share.

    No tunnel is longer than the period of an axis, which leaves two images of a pore along each periodic axis.
    """
    return int(2 ** np.count_nonzero(periods(periodic)))


def wrapped(points: F64, period: F64) -> tuple[F64, I64]:
    """Points moved into [0, period) along the periodic axes, and the whole cells (n, 3) that were taken off.

    The points themselves are returned if they all lie there, and are not modified.
    """
    inside, cells = np.require(points, np.float64, ["C", "W"]), np.zeros(points.shape, np.int64)
    # an axis at a time: there may be millions of points
    for axis in np.flatnonzero(period > 0) if len(points) else ():
        if not 0 <= points[:, axis].min() <= points[:, axis].max() < period[axis]:
            off = np.floor(points[:, axis] / period[axis]) * period[axis]
            inside = inside.copy() if inside is points else inside
            inside[:, axis] -= off
            cells[:, axis] = off
    return inside, cells


def canonical_edges(edges: I64, shifts: I64) -> tuple[I64, I64]:
    """Each edge with i < j, sorted by (i, j, shift), without duplicates.

    Turning an edge round changes the sign of its shift: i -> j + s is the same tunnel as j -> i - s.
    """
    turned = edges[:, 0] > edges[:, 1]
    rows = np.empty((len(edges), 5), dtype=np.int64)
    rows[:, :2] = np.where(turned[:, None], edges[:, ::-1], edges)
    rows[:, 2:] = np.where(turned[:, None], -shifts, shifts)
    rows = rows[np.lexsort(rows.T[::-1])]
    fresh = np.ones(len(rows), dtype=np.bool_)
    fresh[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    rows = rows[fresh]
    return np.ascontiguousarray(rows[:, :2]), np.ascontiguousarray(rows[:, 2:])


def segments(points: F64, edges: Indices, shifts: Indices) -> tuple[F64, F64]:
    """Start ``points[i]`` and end ``points[j] + shift`` of every edge, each (m, 3)."""
    return points[edges[:, 0]], points[edges[:, 1]] + shifts


def edge_lengths(points: F64, edges: Indices, shifts: Indices, metric: F64 | None = None) -> F64:
    """Length of every tunnel, (m,); in the mean of the metrics (n, 6) of its ends, if there are any."""
    starts, ends = segments(points, edges, shifts)
    steps = ends - starts
    if metric is not None:
        return lengths_in((metric[edges[:, 0]] + metric[edges[:, 1]]) / 2, steps)
    lengths: F64 = np.sqrt(steps[:, 0] ** 2 + steps[:, 1] ** 2 + steps[:, 2] ** 2)
    return lengths


def minimum_spanning_tree(points: ArrayLike, *, periodic: Periodic = False) -> tuple[I64, I64]:
    """The exact Euclidean minimum spanning tree, with every pore at its nearest image on the periodic axes.

    Prim's algorithm over all pairs, O(n^2) time and O(n) memory: a nearest-neighbor graph may miss an edge of the tree,
    all pairs can't. Of equally short edges the one to the lower index is taken. Returns sorted pairs i < j (n - 1, 2)
    and shifts (n - 1, 3): the edge runs from ``points[i]`` to ``points[j] + shift``.
    """
    points = as_points(points)
    period = periods(periodic)
    if len(points) < 2:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    inside, cells = wrapped(points, period)
    edges = _prim(inside, period)
    i, j = edges[:, 0], edges[:, 1]
    turns = nearest_turns(inside[j] - inside[i], period).astype(np.int64)
    return canonical_edges(edges, turns + cells[i] - cells[j])


def nearest_turns(steps: F64, period: F64) -> F64:
    """Whole cells that turn steps (..., 3) between pores into those to the nearest image."""
    return -np.rint(steps / np.where(period > 0, period, np.inf)) * period


@jit
def squared_distance(inside: F64, period: F64, i: int, j: int) -> float:
    """Squared distance of i from the nearest image of j."""
    total = 0.0
    for a in range(3):
        step = inside[j, a] - inside[i, a]
        if period[a]:
            step -= period[a] * np.rint(step / period[a])
        total += step * step
    return total


@jit
def _prim(inside: F64, period: F64) -> I64:
    n = inside.shape[0]
    best = np.full(n, np.inf)
    parent = np.zeros(n, np.int64)
    outside = np.ones(n, np.bool_)
    edges = np.empty((n - 1, 2), np.int64)
    last = 0
    outside[0] = False
    for m in range(n - 1):
        nearest = -1
        for j in range(n):
            if outside[j]:
                d = squared_distance(inside, period, last, j)
                if d < best[j] or (d == best[j] and last < parent[j]):
                    best[j] = d
                    parent[j] = last
                if nearest < 0 or best[j] < best[nearest]:
                    nearest = j
        edges[m, 0] = parent[nearest]
        edges[m, 1] = nearest
        outside[nearest] = False
        last = nearest
    return edges


@jit
def kruskal(n: int, edges: Indices, order: I64) -> I64:
    """Indices of the edges that join two components when the edges are taken in the given order, in that order."""
    parent = np.arange(n)
    taken = np.empty(max(n - 1, 0), np.int64)
    count = 0
    for e in order:
        a = find_root(parent, edges[e, 0])
        b = find_root(parent, edges[e, 1])
        if a != b:
            parent[max(a, b)] = min(a, b)
            taken[count] = e
            count += 1
    return taken[:count]


def component_labels(n: int, edges: Indices) -> I64:
    """Component of every vertex, (n,) int64, numbered 0, 1, ... in the order of their lowest vertex."""
    return _component_labels(n, np.array(edges, np.int64))


@jit
def _component_labels(n: int, edges: I64) -> I64:
    parent = np.arange(n)
    for e in range(edges.shape[0]):
        unite(parent, edges[e, 0], edges[e, 1])
    labels = np.empty(n, np.int64)
    count = 0
    for i in range(n):
        root = find_root(parent, i)
        if root == i:
            labels[i] = count
            count += 1
        else:
            labels[i] = labels[root]
    return labels


def bridge_mask(n: int, edges: Indices) -> Bools:
    """Which edges (m, 2) are bridges, (m,) bool; parallel edges are none, as each stands in for the other."""
    degree = np.bincount(edges.ravel(), minlength=n).astype(np.int64)
    node = np.zeros((n + 1, 1 + int(degree.max(initial=0))), dtype=np.int64)
    node[:n, 0] = degree
    ends = edges.ravel()
    order = np.argsort(ends, kind="stable")
    slot = np.arange(len(ends)) - np.repeat(np.cumsum(degree) - degree, degree)
    node[ends[order], 1 + slot] = order // 2
    mask = np.zeros(len(edges), dtype=np.bool_)
    mark_bridges(np.ascontiguousarray(edges, dtype=np.int64), node, 1, mask)
    return mask


@jit
def mark_bridges(edges: I64, node: I64, slots: int, mask: Bools) -> tuple[int, bool]:
    """Set `mask` at every bridge; returns the number of bridges and whether the graph is connected.

    ``node[v, 0]`` is the degree of v, its edges stand from column `slots` on; the last row of `node` belongs to no
    vertex. The first two columns of `edges` are the ends. Tarjan's low-link search with a stack of its own; the edge by
    which a vertex was entered is skipped by its index, so that a parallel edge counts as a way back.
    """
    n = node.shape[0] - 1
    found = np.full(n, -1, np.int64)
    low = np.empty(n, np.int64)
    entry = np.full(n, -1, np.int64)
    next_slot = np.zeros(n, np.int64)
    stack = np.empty(n, np.int64)
    clock = 0
    bridges = 0
    parts = 0
    for root in range(n):
        if found[root] >= 0:
            continue
        parts += 1
        stack[0] = root
        found[root] = low[root] = clock
        clock += 1
        top = 1
        while top > 0:
            v = stack[top - 1]
            if next_slot[v] < node[v, 0]:
                e = node[v, slots + next_slot[v]]
                next_slot[v] += 1
                if e == entry[v]:
                    continue
                w = edges[e, 0] + edges[e, 1] - v
                if found[w] >= 0:
                    low[v] = min(low[v], found[w])
                else:
                    found[w] = low[w] = clock
                    clock += 1
                    entry[w] = e
                    stack[top] = w
                    top += 1
            else:
                top -= 1
                e = entry[v]
                if e >= 0:
                    u = edges[e, 0] + edges[e, 1] - v
                    low[u] = min(low[u], low[v])
                    if low[v] > found[u]:
                        mask[e] = True
                        bridges += 1
    return bridges, parts <= 1
