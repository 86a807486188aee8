"""Tables of a subgraph with bounded degrees, and compiled moves on it: which are allowed, and what they change.

The kernels work on a fixed list of candidate edges, of which a subset is chosen. A move takes out up to two chosen
edges and puts in up to two others along an alternating trail, so that only the degrees at the ends of the trail change.

Integers are kept in two tables with named columns, because the time to compile a call grows with its number of arrays:

* ``edge`` (m, 5): the two vertices, `CHOSEN` (0 or 1), and the range `CONFLICT_FROM`, `CONFLICT_TO` in
  ``conflict`` of the edges that may not be chosen beside it;
* ``node`` (n + 1, 7 + slots): `DEGREE` and its bounds `LOWER`, `UPPER`; the range `FROM`, `TO` in ``near``, where the
  edges at each vertex stand by rising length; `SEEN`, `QUEUE`: scratch of the searches; from `SLOTS` on the chosen
  edges at the vertex. The last row belongs to no vertex; its `SEEN` is the stamp of the latest search, its `UPPER` the
  number of vertices at which a search gives up.

``length`` (m,) is the cost of an edge. "No edge" is ``int(np.int64(-1))``: Numba would compile a call once more for
each combination of literals.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.connecting.trees import mark_bridges
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit

CHOSEN, CONFLICT_FROM, CONFLICT_TO = 2, 3, 4

DEGREE, FROM, TO, SEEN, QUEUE, LOWER, UPPER, SLOTS = 0, 1, 2, 3, 4, 5, 6, 7


def edge_table(edges: I64, length: F64, conflicts: I64) -> tuple[I64, I64, I64, I64]:
    """The table ``edge`` with no edge chosen, ``conflict``, ``near``, and the edges by rising length, (m,).

    `conflicts` (c, 2) are pairs of edges that exclude each other; a pair (e, e) excludes e.
    """
    # stable: of equally long edges the first one comes first, on every machine
    order = np.argsort(length, kind="stable")
    edge = np.zeros((len(edges), 5), np.int64)
    edge[:, :2] = edges
    owner = conflicts.ravel()
    edge[:, CONFLICT_TO] = np.cumsum(np.bincount(owner, minlength=len(edges)))
    edge[1:, CONFLICT_FROM] = edge[:-1, CONFLICT_TO]
    # an entry and its partner in the pair stand at positions that differ in the last bit
    conflict = owner[np.argsort(owner, kind="stable") ^ 1]
    near = order[np.argsort(edges[order].ravel(), kind="stable") // 2]
    return edge, conflict, near, order


def node_table(n: int, edges: I64, lower: int | I64, upper: int | I64, slots: int, detour: int) -> I64:
    """The table ``node`` for the candidate edges (m, 2) and bounds of the degrees of n vertices, with no edge chosen.

    There is room for `slots` chosen edges at each vertex; a way round is looked for among `detour` vertices.
    """
    node = np.zeros((n + 1, SLOTS + slots), np.int64)
    node[:n, TO] = np.cumsum(np.bincount(edges.ravel(), minlength=n))
    node[1:n, FROM] = node[: n - 1, TO]
    node[:n, LOWER] = lower
    node[:n, UPPER] = upper
    node[n, UPPER] = detour
    return node


@jit
def insert(edge: I64, node: I64, e: int) -> None:
    """Choose edge e."""
    edge[e, CHOSEN] = 1
    for p in range(2):
        v = edge[e, p]
        node[v, SLOTS + node[v, DEGREE]] = e
        node[v, DEGREE] += 1


@jit
def insert_all(edge: I64, node: I64, chosen: I64) -> None:
    """Choose the edges."""
    for e in chosen:
        insert(edge, node, e)


@jit
def _remove(edge: I64, node: I64, e: int) -> None:
    edge[e, CHOSEN] = 0
    for p in range(2):
        v = edge[e, p]
        node[v, DEGREE] -= 1
        last = SLOTS + node[v, DEGREE]
        for s in range(SLOTS, last):
            if node[v, s] == e:
                node[v, s] = node[v, last]
                break


@jit
def apply_move(edge: I64, node: I64, out1: int, out2: int, in1: int, in2: int) -> None:
    """Take the edges out and put the others in; -1 stands for none."""
    for e in (out1, out2):
        if e >= 0:
            _remove(edge, node, e)
    for e in (in1, in2):
        if e >= 0:
            insert(edge, node, e)


@jit
def clear(edge: I64, conflict: I64, e: int, out1: int, out2: int, beside: int) -> bool:
    """True if e conflicts neither with itself or a chosen edge (but out1, out2) nor with the edge `beside`."""
    for s in range(edge[e, CONFLICT_FROM], edge[e, CONFLICT_TO]):
        f = conflict[s]
        if f in (e, beside) or (edge[f, CHOSEN] and f != out1 and f != out2):
            return False
    return True


@jit
def joined(edge: I64, node: I64, start: int, goal: int, out1: int, out2: int, in1: int, in2: int) -> bool:
    """True if a path leads from start to goal once the move is made (breadth first; neighbors are met soon).

    After the number of vertices in the last row's `UPPER` the search gives up, and the answer is no.
    """
    n = node.shape[0] - 1
    node[n, SEEN] += 1
    stamp = node[n, SEEN]
    node[start, SEEN] = stamp
    node[0, QUEUE] = start
    head, tail = 0, 1
    while head < tail and head < node[n, UPPER]:
        v = node[head, QUEUE]
        head += 1
        degree = node[v, DEGREE]
        for s in range(degree + 2):
            if s < degree:
                e = node[v, SLOTS + s]
                if e in (out1, out2):
                    continue
            else:
                e = in1 if s == degree else in2
                if e < 0 or (edge[e, 0] != v and edge[e, 1] != v):
                    continue
            w = edge[e, 0] + edge[e, 1] - v
            if w == goal:
                return True
            if node[w, SEEN] != stamp:
                node[w, SEEN] = stamp
                node[tail, QUEUE] = w
                tail += 1
    return False


@jit
def allowed(edge: I64, node: I64, conflict: I64, out1: int, out2: int, in1: int, in2: int, loops: bool) -> bool:
    """True if the move keeps the graph connected (with `loops`: without bridges) and clear. Degrees are not checked."""
    for e, beside in ((in1, in2), (in2, in1)):
        if e >= 0 and not clear(edge, conflict, e, out1, out2, beside):
            return False
    if loops:
        apply_move(edge, node, out1, out2, in1, in2)
        # with loops the move is tried: bridges depend on the whole graph, not on a path
        bridges, connected = mark_bridges(edge, node, int(np.int64(SLOTS)), np.zeros(edge.shape[0], np.bool_))
        apply_move(edge, node, in1, in2, out1, out2)
        return connected and bridges == 0
    for e in (out1, out2):
        if e >= 0 and not joined(edge, node, edge[e, 0], edge[e, 1], out1, out2, in1, in2):
            return False
    return True
