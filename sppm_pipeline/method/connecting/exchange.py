"""Compiled moves on a spanning subgraph with bounded degrees: build, repair, close loops, improve by exchange.

Tables and moves are those of `moves`.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connecting.moves import (
    CHOSEN,
    DEGREE,
    FROM,
    LOWER,
    SLOTS,
    TO,
    UPPER,
    allowed,
    apply_move,
    clear,
    insert,
    joined,
)
from sppm_pipeline.method.connecting.trees import mark_bridges
from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root


@jit
def connect_and_fill(edge: I64, node: I64, length: F64, near: I64, order: I64) -> bool:
    """Choose a spanning tree with degrees <= upper, then edges until every degree is >= lower.

    Returns False if there are not enough candidate edges for it.
    """
    n = node.shape[0] - 1
    parent = np.arange(n)
    parts = n
    for e in order:
        u, v = edge[e, 0], edge[e, 1]
        if node[u, DEGREE] < node[u, UPPER] and node[v, DEGREE] < node[v, UPPER]:
            a, b = find_root(parent, u), find_root(parent, v)
            if a != b:
                insert(edge, node, e)
                parent[max(a, b)] = min(a, b)
                parts -= 1
    # the tree uses the shortest edges; what is missing to the lower bounds is added by length, too
    fill(edge, node, order)
    return parts == 1 and raise_degrees(edge, node, length, near) == 0


@jit
def fill(edge: I64, node: I64, order: I64) -> None:
    """Add edges, the shortest first, between vertices that are both below their lower bounds."""
    for e in order:
        u, v = edge[e, 0], edge[e, 1]
        if not edge[e, CHOSEN] and node[u, DEGREE] < node[u, LOWER] and node[v, DEGREE] < node[v, LOWER]:
            insert(edge, node, e)


@jit
def raise_degrees(edge: I64, node: I64, length: F64, near: I64) -> int:
    """Add edges until every degree is >= lower; returns how many vertices find no candidate edges for it."""
    left = int(np.int64(0))
    for u in range(node.shape[0] - 1):
        while node[u, DEGREE] < node[u, LOWER]:
            if not _raise_degree(edge, node, length, near, u):
                left += 1
                break
    return left


@jit
def lower_degrees(edge: I64, node: I64, length: F64, near: I64) -> int:
    """Turn edges at vertices above their upper bound to other vertices near by; returns how many stay above it."""
    none = int(np.int64(-1))
    left = int(np.int64(0))
    for u in range(node.shape[0] - 1):
        while node[u, DEGREE] > node[u, UPPER]:
            best = np.inf
            out = put = none
            for s in range(SLOTS, SLOTS + node[u, DEGREE]):
                e1 = node[u, s]
                t = edge[e1, 0] + edge[e1, 1] - u
                spare = -length[e1] < best and node[t, DEGREE] > node[t, LOWER]
                if spare and joined(edge, node, u, t, e1, none, none, none):
                    best, out, put = -length[e1], e1, none
                for q in range(node[t, FROM], node[t, TO]):
                    e2 = near[q]
                    cost = length[e2] - length[e1]
                    if cost >= best:
                        break
                    w = edge[e2, 0] + edge[e2, 1] - t
                    if w == u or edge[e2, CHOSEN] or node[w, DEGREE] >= node[w, UPPER]:
                        continue
                    if joined(edge, node, u, t, e1, none, e2, none):
                        best, out, put = cost, e1, e2
            if out < 0:
                left += 1
                break
            apply_move(edge, node, out, none, put, none)
    return left


@jit
def _raise_degree(edge: I64, node: I64, length: F64, near: I64, u: int) -> bool:
    """One more edge at u along the cheapest trail: in; in, out; or in, out, in."""
    none = int(np.int64(-1))
    best = np.inf
    put1 = out = put2 = none
    for s in range(node[u, FROM], node[u, TO]):
        e1 = near[s]
        if edge[e1, CHOSEN]:
            continue
        t1 = edge[e1, 0] + edge[e1, 1] - u
        # slot -1 is the trail that ends with the first edge
        for r in range(-1, node[t1, DEGREE]):
            e2 = node[t1, SLOTS + r] if r >= 0 else none
            t2 = edge[e2, 0] + edge[e2, 1] - t1 if r >= 0 else t1
            cost = length[e1] - (length[e2] if r >= 0 else 0.0)
            if t2 == u:
                continue
            # the position before the first is the trail that ends here
            for q in range(node[t2, FROM] - 1, node[t2, TO] if r >= 0 else node[t2, FROM]):
                if q < node[t2, FROM]:
                    e3, total = none, cost
                    ends_well = node[t2, DEGREE] > node[t2, LOWER] if r >= 0 else node[t1, DEGREE] < node[t1, UPPER]
                else:
                    e3 = near[q]
                    total = cost + length[e3]
                    t3 = edge[e3, 0] + edge[e3, 1] - t2
                    ends_well = node[t3, DEGREE] + (t3 == u) < node[t3, UPPER]
                    ends_well = ends_well and e3 != e1 and not edge[e3, CHOSEN]
                    if total >= best:
                        break
                if not ends_well or total >= best:
                    continue
                if e2 < 0 or joined(edge, node, edge[e2, 0], edge[e2, 1], e2, none, e1, e3):
                    best, put1, out, put2 = total, e1, e2, e3
    if put1 < 0:
        return False
    apply_move(edge, node, out, none, put1, put2)
    return True


@jit
def improve(edge: I64, node: I64, conflict: I64, length: F64, near: I64, waiting: Bools, loops: bool) -> None:
    """Make moves that shorten the graph until none is left; a vertex is tried again after a move near it.

    Only the vertices `waiting` are tried at first; none is when this returns.

    A conflict weighs more than any length: a chosen edge in conflict is taken out at any cost, if a move allows it, and
    no edge that would conflict is put in. So the number of conflicts falls, but need not reach 0.
    """
    n = node.shape[0] - 1
    left = waiting.sum()
    # what a conflict adds to the worth of taking an edge out: two edges put in can't outweigh it
    penalty = 3.0 * length.max()
    v = int(np.int64(0))
    while left > 0:
        if waiting[v]:
            move = _shorter(edge, node, conflict, length, near, v, loops, penalty)
            if move[0] >= 0:
                apply_move(edge, node, move[0], move[1], move[2], move[3])
                for e in move:
                    if e >= 0:
                        for p in range(2):
                            left += not waiting[edge[e, p]]
                            waiting[edge[e, p]] = True
                continue
            waiting[v] = False
            left -= 1
        v = v + 1 if v + 1 < n else 0


@jit
def _shorter(
    edge: I64, node: I64, conflict: I64, length: F64, near: I64, t0: int, loops: bool, penalty: float
) -> tuple[int, int, int, int]:
    """The first shortening move whose trail starts by taking out an edge at t0: (out, out, in, in), -1 for none.

    The trail is out, in, out, in or a beginning of it, and closed if it comes back to t0; its partial gain stays
    positive (S. Lin, B. W. Kernighan, Operations Research 21, 1973).
    """
    tiny, none = 1e-12, int(np.int64(-1))
    spare = node[t0, DEGREE] > node[t0, LOWER]
    for s1 in range(node[t0, DEGREE]):
        e1 = node[t0, SLOTS + s1]
        t1 = edge[e1, 0] + edge[e1, 1] - t0
        worth = length[e1] if clear(edge, conflict, e1, none, none, none) else length[e1] + penalty
        if spare and node[t1, DEGREE] > node[t1, LOWER] and allowed(edge, node, conflict, e1, none, none, none, loops):
            return e1, none, none, none
        for s2 in range(node[t1, FROM], node[t1, TO]):
            e2 = near[s2]
            gain2 = worth - length[e2]
            if gain2 <= tiny:
                break
            if edge[e2, CHOSEN]:
                continue
            t2 = edge[e2, 0] + edge[e2, 1] - t1
            ends_well = t2 == t0 or (spare and node[t2, DEGREE] < node[t2, UPPER])
            if ends_well and allowed(edge, node, conflict, e1, none, e2, none, loops):
                return e1, none, e2, none
            if t2 == t0:
                continue
            for s3 in range(node[t2, DEGREE]):
                e3 = node[t2, SLOTS + s3]
                t3 = edge[e3, 0] + edge[e3, 1] - t2
                gain3 = gain2 + length[e3]
                if e3 == e1 or t3 == t1:
                    continue
                ends_well = spare and node[t3, DEGREE] - (t3 == t0) > node[t3, LOWER]
                if ends_well and allowed(edge, node, conflict, e1, e3, e2, none, loops):
                    return e1, e3, e2, none
                for s4 in range(node[t3, FROM], node[t3, TO]):
                    e4 = near[s4]
                    if gain3 - length[e4] <= tiny:
                        break
                    if edge[e4, CHOSEN] or e4 == e2:
                        continue
                    t4 = edge[e4, 0] + edge[e4, 1] - t3
                    ends_well = t4 == t0 or (spare and node[t4, DEGREE] < node[t4, UPPER])
                    if ends_well and allowed(edge, node, conflict, e1, e3, e2, e4, loops):
                        return e1, e3, e2, e4
    return none, none, none, none


@jit
def make_loops(edge: I64, node: I64, length: F64, near: I64) -> bool:
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
