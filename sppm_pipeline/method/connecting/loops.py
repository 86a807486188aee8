"""Loops through every edge of a spanning subgraph with bounded degrees: no single lost tunnel then cuts the graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connecting.moves import CHOSEN, DEGREE, FROM, SLOTS, TO, UPPER, apply_move
from sppm_pipeline.method.connecting.trees import find_root, mark_bridges
from sppm_pipeline.services.jit.compiled import jit


@jit
def make_loops(
    edge: NDArray[np.int64],
    node: NDArray[np.int64],
    length: NDArray[np.float64],
    near: NDArray[np.int64],
) -> bool:
    """Remove all bridges: join the smallest block that has one bridge to another block, until one block is left.

    Either one edge is added, or one edge of each block is replaced by two edges between the blocks; an edge of a loop
    leaves its block connected, and the two new edges close a loop through both. Returns False if no edge does it.
    """
    n = node.shape[0] - 1
    m = edge.shape[0]
    none = int(np.int64(-1))
    while True:
        bridge = np.zeros(m, np.bool_)
        count, _ = mark_bridges(edge, node, int(np.int64(SLOTS)), bridge)
        if count == 0:
            return True
        block = np.arange(n)
        for e in range(m):
            if edge[e, CHOSEN] and not bridge[e]:
                a, b = find_root(block, edge[e, 0]), find_root(block, edge[e, 1])
                block[max(a, b)] = min(a, b)
        size = np.zeros(n, np.int64)
        bridges_of = np.zeros(n, np.int64)
        for v in range(n):
            block[v] = find_root(block, v)
            size[block[v]] += 1
        for e in range(m):
            if bridge[e]:
                bridges_of[block[edge[e, 0]]] += 1
                bridges_of[block[edge[e, 1]]] += 1
        leaf = -1
        for v in range(n):
            if bridges_of[v] == 1 and (leaf < 0 or size[v] < size[leaf]):
                leaf = v
        best = np.inf
        out1 = out2 = in1 = in2 = none
        for e in range(m):
            if edge[e, CHOSEN] or (block[edge[e, 0]] == leaf) == (block[edge[e, 1]] == leaf):
                continue
            p = 0 if block[edge[e, 0]] == leaf else 1
            x, y = edge[e, p], edge[e, 1 - p]
            cost = length[e]
            room = node[x, DEGREE] < node[x, UPPER] and node[y, DEGREE] < node[y, UPPER]
            if cost < best and room:
                best, out1, out2, in1, in2 = cost, none, none, e, none
            for s in range(SLOTS, SLOTS + node[x, DEGREE]):
                here = node[x, s]
                if bridge[here]:
                    continue
                far = edge[here, 0] + edge[here, 1] - x
                for r in range(SLOTS, SLOTS + node[y, DEGREE]):
                    there = node[y, r]
                    if bridge[there]:
                        continue
                    goal = edge[there, 0] + edge[there, 1] - y
                    for q in range(node[far, FROM], node[far, TO]):
                        f = near[q]
                        total = cost - length[here] - length[there] + length[f]
                        if total >= best:
                            break
                        if edge[f, 0] + edge[f, 1] - far != goal or edge[f, CHOSEN] or f == e:
                            continue
                        best, out1, out2, in1, in2 = total, here, there, e, f
                        break
        if in1 < 0:
            return False
        apply_move(edge, node, out1, out2, in1, in2)
