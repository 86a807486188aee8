"""Bridges: the edges whose loss would cut a graph in two."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit


def bridge_mask(n: int, edges: NDArray[np.int64]) -> NDArray[np.bool_]:
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
def mark_bridges(
    edges: NDArray[np.int64], node: NDArray[np.int64], slots: int, mask: NDArray[np.bool_]
) -> tuple[int, bool]:
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
