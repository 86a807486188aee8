"""The relative neighborhood graph with degrees brought into bounds: cut where a loop allows, raised by short edges."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.buckets import sorted_into_buckets
from sppm_pipeline.method.connecting.candidates import bridging_edges, edges_of_keys, nearest_keys
from sppm_pipeline.method.connecting.relative import relative_neighbors
from sppm_pipeline.method.connecting.trees import edge_lengths, kruskal, nearest_turns, wrapped
from sppm_pipeline.services.arrays import F64, I8, I32, I64, Bools
from sppm_pipeline.services.jit.compiled import jit

REACH = 6.0
"""Longest edge that is looked for, in mean distances of pores. In random packings of any density none is longer than
2.3 (measured, 10^5 pores); across hollows of a part longer ones are made only where the graph would fall apart."""

_DETOUR = 1000
"""Pores that the search for a way round a tunnel visits (heuristic): it bounds the time
where there is no loop. A loop that is longer counts as none, and the tunnel stays."""

_NEAREST, _MAX_NEAREST = 10, 40
"""Nearest pores among which one with too few tunnels looks for more, at first and at last."""


class Network(NamedTuple):
    """Tunnels between pores that were moved into the periodic box."""

    edges: I32  # (m, 2) pairs i < j
    turns: I8  # (m, 3) periods by which the image of j is moved


def relative_neighbor_graph(
    points: F64, period: F64, degree: tuple[int, int], *, reach: float = np.inf, threads: int = 1
) -> tuple[I32, I32, int]:
    """Connected graph of relative neighbors with degrees raised to A, and cut to B where a loop allows it.

    Edges longer than `reach` are made only where the graph would fall apart; `REACH` mean distances leave none out.
    Returns edges and shifts as `spanning_subgraph` does, and the number of pores with more than B tunnels; raises
    DesignError if a pore with too few tunnels finds no pore with room near by.
    """
    network = connected_neighbors(points, period, reach=reach, threads=threads)
    network, over = cut_degrees(points, period, network, *degree)
    network = raise_degrees(points, period, network, *degree)
    return *as_tunnels(points, period, network), over


def shortest_tree(points: F64, period: F64, *, reach: float = np.inf, threads: int = 1) -> tuple[I32, I32]:
    """The Euclidean minimum spanning tree by Kruskal's algorithm on the relative neighbors, which contain it.

    Arguments, edges (n - 1, 2) and shifts as in `relative_neighbor_graph`.
    """
    network = connected_neighbors(points, period, reach=reach, threads=threads)
    return as_tunnels(points, period, tree_of(points, period, network))


def tree_of(points: F64, period: F64, network: Network, metric: F64 | None = None) -> Network:
    """The shortest tree among the edges of a connected network; of equally short ones the first are taken."""
    inside, _ = wrapped(points, period)
    period_of = period.astype(np.int64)
    length = edge_lengths(inside, network.edges, network.turns * period_of, metric)
    taken = kruskal(len(points), network.edges, np.argsort(length, kind="stable"))
    return Network(network.edges[taken], network.turns[taken])


def connected_neighbors(points: F64, period: F64, *, reach: float = np.inf, threads: int = 1) -> Network:
    """The relative neighborhood graph up to the length `reach`, and the longer edges that it needs.

    Together they contain the Euclidean minimum spanning tree: its edges up to that length are relative neighbors, and
    the longer ones are the shortest that join what those leave apart.
    """
    edges, turns = relative_neighbors(points, period, reach=reach, threads=threads)
    bridges, _ = bridging_edges(points, edges, period)
    if len(bridges):
        inside, _ = wrapped(points, period)
        steps = nearest_turns(inside[bridges[:, 1]] - inside[bridges[:, 0]], period)
        more = np.rint(steps / np.where(period > 0, period, np.inf)).astype(np.int8)
        edges, turns = np.concatenate([edges, bridges.astype(np.int32)]), np.concatenate([turns, more])
    return Network(edges, turns)


def cut_degrees(points: F64, period: F64, network: Network, lower: int, upper: int) -> tuple[Network, int]:
    """The network without the longest edges at pores that have more than `upper`, and how many still have.

    An edge goes if it lies on a loop, and if its other end keeps `lower` edges.
    """
    edges, turns = network
    degree = degrees_of(len(points), edges)
    if degree.max(initial=0) <= upper:
        return network, 0
    inside, _ = wrapped(points, period)
    crowded = np.flatnonzero(_touching(edges, degree > upper))
    length = edge_lengths(inside, edges[crowded], turns[crowded] * period.astype(np.int64))
    order = crowded[np.argsort(-length, kind="stable")]
    kept = _cut(edges, *ends_by_pore(edges, degree), degree, order, lower, upper, _DETOUR)
    return Network(edges[kept], turns[kept]), int((degree > upper).sum())


def raise_degrees(points: F64, period: F64, network: Network, lower: int, upper: int) -> Network:
    """The network with the shortest edges from pores that have fewer than `lower` to pores near by that have room.

    Raises DesignError if there are no more such pores.
    """
    n = len(points)
    inside, _ = wrapped(points, period)
    edges, turns = network
    degree = degrees_of(n, edges)
    k = _NEAREST
    while (poor := np.flatnonzero(degree < lower)).size:
        if k > _MAX_NEAREST:
            raise DesignError(
                f"{len(poor)} of {n} pores find fewer than {lower} tunnels: the pores around them all have {upper}",
                hint="widen the degree bounds, for example to [3, 5]",
            )
        keys = np.sort(nearest_keys(sorted_into_buckets(inside, period), poor, k).ravel())
        keys = keys[(keys >= 0) & (np.diff(keys, prepend=-1) > 0)]
        there = _touching(edges, degree < lower)
        keys = np.setdiff1d(keys, _keys(edges[there], turns[there], n), assume_unique=True)
        more, images = edges_of_keys(keys, n)
        order = np.argsort(edge_lengths(inside, more, images * period.astype(np.int64)), kind="stable")
        added = order[_raise(more, degree, order, lower, upper)]
        edges = np.concatenate([edges, more[added].astype(np.int32)])
        turns = np.concatenate([turns, images[added].astype(np.int8)])
        k *= 2
    return Network(edges, turns)


def _keys(edges: I32, turns: I8, n: int) -> I64:
    """Keys of edges as those of `nearest_keys`, (m,)."""
    code = 9 * turns[:, 0] + 3 * turns[:, 1] + turns[:, 2] + np.int8(13)
    return (edges[:, 0].astype(np.int64) * n + edges[:, 1]) * 27 + code


def as_tunnels(points: F64, period: F64, network: Network) -> tuple[I32, I32]:
    """Edges (m, 2), sorted by (i, j, shift), and shifts (m, 3) in whole cells between the points as they were given."""
    edges, turns = _sorted_by_pores(*network, len(points))
    shifts = turns.astype(np.int32)
    shifts *= period.astype(np.int32)
    for axis in np.flatnonzero(period > 0):
        cells = (np.floor(points[:, axis] / period[axis]) * period[axis]).astype(np.int32)
        if cells.any():
            shifts[:, axis] += cells[edges[:, 0]] - cells[edges[:, 1]]
    return edges, shifts


@jit
def degrees_of(n: int, edges: I32) -> I32:
    """Number of edges at each of n pores, (n,)."""
    degree = np.zeros(n, np.int32)
    for e in range(len(edges)):
        degree[edges[e, 0]] += 1
        degree[edges[e, 1]] += 1
    return degree


@jit
def _touching(edges: I32, marked: Bools) -> Bools:
    """Which edges end in a marked pore, (m,)."""
    found = np.empty(len(edges), np.bool_)
    for e in range(len(edges)):
        found[e] = marked[edges[e, 0]] or marked[edges[e, 1]]
    return found


@jit
def ends_by_pore(edges: I32, degree: I32) -> tuple[I32, I64]:
    """Numbers ``2 e + side`` of the ends of edges by pore, (2 m,), and where those of each pore begin, (n + 1,)."""
    start = np.zeros(len(degree) + 1, np.int64)
    for i in range(len(degree)):
        start[i + 1] = start[i] + degree[i]
    around = np.empty(2 * len(edges), np.int32)
    for e in range(len(edges)):
        for side in range(2):
            i = edges[e, side]
            around[start[i]] = 2 * e + side
            start[i] += 1
    for i in range(len(degree), 0, -1):
        start[i] = start[i - 1]
    start[0] = 0
    return around, start


@jit
def _sorted_by_pores(edges: I32, turns: I8, n: int) -> tuple[I32, I8]:
    """The edges sorted by (i, j, turns): counted by i, and each put in its place among the few of its pore."""
    low = np.zeros(n + 1, np.int64)
    for e in range(len(edges)):
        low[edges[e, 0] + 1] += 1
    for i in range(n):
        low[i + 1] += low[i]
    placed = np.zeros(n, np.int32)
    ends = np.empty_like(edges)
    moved = np.empty_like(turns)
    for e in range(len(edges)):
        i, j = edges[e, 0], edges[e, 1]
        x, y, z = turns[e, 0], turns[e, 1], turns[e, 2]
        s = low[i] + placed[i]
        placed[i] += 1
        while s > low[i]:
            t = s - 1
            if (ends[t, 1], moved[t, 0], moved[t, 1], moved[t, 2]) <= (j, x, y, z):
                break
            ends[s, 1], moved[s, 0], moved[s, 1], moved[s, 2] = ends[t, 1], moved[t, 0], moved[t, 1], moved[t, 2]
            s = t
        ends[s, 1], moved[s, 0], moved[s, 1], moved[s, 2] = j, x, y, z
    for i in range(n):
        for s in range(low[i], low[i + 1]):
            ends[s, 0] = i
    return ends, moved


@jit
def _cut(edges: I32, around: I32, start: I64, degree: I32, order: I64, lower: int, upper: int, detour: int) -> Bools:
    """Which edges are left, (m,); `degree` is brought up to date.

    ``around[start[v] : start[v + 1]] // 2`` are the edges at v.
    """
    kept = np.ones(len(edges), np.bool_)
    seen = np.full(len(degree), -1, np.int32)
    queue = np.empty(detour, np.int64)
    for e in order:
        u, v = edges[e, 0], edges[e, 1]
        if (degree[u] <= upper and degree[v] <= upper) or degree[u] <= lower or degree[v] <= lower:
            continue
        kept[e] = False
        seen[u] = e
        queue[0] = u
        head, tail = 0, 1
        found = False
        while head < tail and not found:
            x = queue[head]
            head += 1
            for s in range(start[x], start[x + 1]):
                f = around[s] // 2
                y = edges[f, 0] + edges[f, 1] - x
                if kept[f] and seen[y] != e and tail < detour:
                    seen[y] = e
                    queue[tail] = y
                    tail += 1
                    found |= y == v
        if found:
            degree[u] -= 1
            degree[v] -= 1
        else:
            kept[e] = True
    return kept


@jit
def _raise(edges: I64, degree: I32, order: I64, lower: int, upper: int) -> Bools:
    """Which edges of the order are added; `degree` is brought up to date."""
    added = np.zeros(len(order), np.bool_)
    for s in range(len(order)):
        u, v = edges[order[s], 0], edges[order[s], 1]
        if (degree[u] < lower or degree[v] < lower) and degree[u] < upper and degree[v] < upper:
            added[s] = True
            degree[u] += 1
            degree[v] += 1
    return added
