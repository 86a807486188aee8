"""Greedy graphs of many small pieces, and the tunnels between interiors and faces, in a few calls and by threads.

A set of a thousand cells has four thousand pieces of some dozen pores. `greedy_subgraph` takes a tenth of its time in
kernels for one of these; the rest is arrays that are made and thrown away. Here one kernel goes through a run of
pieces. The graphs are the same, edge by edge: a piece that the kernel can't finish is left to `greedy_subgraph`, which
then widens the candidates, joins what falls apart, or says why there is no graph.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numpy as np

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.exchange import connect_and_fill, improve
from sppm_pipeline.method.connecting.greedy import clamped_degrees, feasible_degrees
from sppm_pipeline.method.connecting.moves import CHOSEN, CONFLICT_FROM, DEGREE, FROM, LOWER, SLOTS, TO, UPPER
from sppm_pipeline.services.arrays import F64, I8, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.threads import ordered_map

LARGEST = 400
"""Pores of a piece up to which all pairs are looked at: up to some five hundred that takes less time than buckets, and
of larger pieces the kernels take most of the time anyway."""

_RUN = 128
"""Pieces that are joined in one call: enough that the call costs nothing, few enough that all threads have work."""


def greedy_pieces(
    points: F64, order: I64, first: I64, pieces: I64, degrees: I64, *, k: int, threads: int = 1
) -> Iterator[tuple[I64, I32, I64]]:
    """The graphs of `greedy_subgraph` for many pieces that do not repeat, without clearance or loops.

    `order` (n,) are the pores by piece, where each begins at `first` (number of pieces + 1,); `pieces` (p,) those to be
    joined, of 2 pores or more, and `degrees` (p, 2) what `piece_degrees` says of each. The result does not depend on
    the threads.

    Yields the next of the pieces (q,); edges (m, 2), rows of `points`, piece after piece, in each pairs in the order of
    `order`, sorted; and how many each has (q,), -1 for one that is left to `greedy_subgraph`.
    """

    # in one array, as thousands of small ones would leave the memory in shreds; what is not written takes none
    bound = np.concatenate([[0], np.cumsum((first[pieces + 1] - first[pieces]) * degrees[:, 1] // 2)])
    room = np.empty((int(bound[-1]), 2), np.int32)

    def joined(start: int) -> tuple[I64, I32, I64]:
        own = pieces[start : start + _RUN]
        counts = np.empty(len(own), np.int64)
        rows = room[bound[start] : bound[start + len(own)]]
        used = _join(points, order, first, own, degrees[start : start + _RUN], k, rows, counts)
        return own, rows[:used], counts

    runs = range(0, len(pieces), _RUN)
    return ordered_map(joined, runs, min(threads, max(len(runs), 1)))


def piece_degrees(sizes: I64, interiors: int, degree: tuple[int, int]) -> I64:
    """Bounds of the degrees in each piece, (p, 2); 0, 0 for one that is left to `greedy_subgraph`.

    Those are the pieces of more than `LARGEST` pores, and those in which no graph has these degrees. `sizes` (p,) are
    the pores of each piece, `interiors` first; the others are faces, with bounds relaxed by `clamped_degrees`.
    """
    degrees = np.zeros((len(sizes), 2), np.int64)
    for on_face, part in ((False, slice(interiors)), (True, slice(interiors, None))):
        kinds, which = np.unique(sizes[part], return_inverse=True)
        bounds = np.zeros((len(kinds), 2), np.int64)
        for row, n in enumerate(kinds.tolist()):
            lower, upper = clamped_degrees(n, *degree)[:2] if on_face else degree
            if 1 < n <= LARGEST:
                with contextlib.suppress(DesignError):
                    feasible_degrees(n, lower, upper)
                    bounds[row] = max(lower, 1), upper
        degrees[part] = bounds[which]
    return degrees


@jit
def _join(points: F64, order: I64, first: I64, pieces: I64, degrees: I64, k: int, room: I32, counts: I64) -> int:
    """Write the edges of the pieces to `room` and their numbers to `counts`; returns how many rows were written."""
    used = 0
    conflict = np.zeros(0, np.int64)
    for row in range(len(pieces)):
        counts[row] = -1
        if degrees[row, 1] == 0:
            continue
        start = first[pieces[row]]
        n = first[pieces[row] + 1] - start
        own = np.empty((n, 3))
        for i in range(n):
            for axis in range(3):
                own[i, axis] = points[order[start + i], axis]
        edge = _candidates(own, min(k, n - 1))
        m = edge.shape[0]
        length = np.empty(m)
        for e in range(m):
            i, j = edge[e, 0], edge[e, 1]
            dx, dy, dz = own[j, 0] - own[i, 0], own[j, 1] - own[i, 1], own[j, 2] - own[i, 2]
            length[e] = np.sqrt(dx * dx + dy * dy + dz * dz)
        by_length = _stable_order(length)
        node = _nodes(n, edge, degrees[row, 0], degrees[row, 1])
        near = _near(edge, node, by_length)
        if connect_and_fill(edge, node, length, near, by_length):
            improve(edge, node, conflict, length, near, np.ones(n, np.bool_), False)
            counts[row] = 0
            for e in range(m):
                if edge[e, CHOSEN]:
                    room[used, 0] = order[start + edge[e, 0]]
                    room[used, 1] = order[start + edge[e, 1]]
                    used += 1
                    counts[row] += 1
    return used


@jit
def _candidates(points: F64, k: int) -> I64:
    """The table ``edge`` of `exchange` of all pairs of which one is among the k nearest of the other, sorted.

    Equally near neighbors are taken by index, as in `candidate_graph`.
    """
    n = points.shape[0]
    marked = np.zeros((n, n), np.bool_)
    best = np.empty(k)
    who = np.empty(k, np.int64)
    number = 0
    for i in range(n):
        count = 0
        for j in range(n):
            if j == i:
                continue
            dx, dy, dz = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2]
            d = dx * dx + dy * dy + dz * dz
            if count == k and d >= best[k - 1]:
                continue
            slot = count if count < k else k - 1
            count = min(count + 1, k)
            while slot > 0 and d < best[slot - 1]:
                best[slot] = best[slot - 1]
                who[slot] = who[slot - 1]
                slot -= 1
            best[slot] = d
            who[slot] = j
        for s in range(count):
            low, high = min(i, who[s]), max(i, who[s])
            number += not marked[low, high]
            marked[low, high] = True
    edge = np.zeros((number, CONFLICT_FROM + 2), np.int64)
    e = 0
    for i in range(n):
        for j in range(i + 1, n):
            if marked[i, j]:
                edge[e, 0] = i
                edge[e, 1] = j
                e += 1
    return edge


@jit
def _stable_order(length: F64) -> I64:
    """The indices that sort by length, equal ones by index: sorted roughly by counting, then by insertion."""
    m = len(length)
    shortest, longest = np.inf, 0.0
    for e in range(m):
        shortest = min(shortest, length[e])
        longest = max(longest, length[e])
    scale = (m - 1) / (longest - shortest) if longest > shortest else 0.0
    start = np.zeros(m + 1, np.int64)
    for e in range(m):
        start[min(int((length[e] - shortest) * scale), m - 1) + 1] += 1
    for b in range(m):
        start[b + 1] += start[b]
    order = np.empty(m, np.int64)
    for e in range(m):
        b = min(int((length[e] - shortest) * scale), m - 1)
        order[start[b]] = e
        start[b] += 1
    # the buckets are in order and hold one or two each
    for s in range(1, m):
        e = order[s]
        t = s
        while t > 0 and length[order[t - 1]] > length[e]:
            order[t] = order[t - 1]
            t -= 1
        order[t] = e
    return order


@jit
def _nodes(n: int, edge: I64, lower: int, upper: int) -> I64:
    """`node_table` of the candidate edges."""
    node = np.zeros((n + 1, SLOTS + upper), np.int64)
    for e in range(edge.shape[0]):
        node[edge[e, 0], TO] += 1
        node[edge[e, 1], TO] += 1
    for v in range(n):
        if v > 0:
            node[v, FROM] = node[v - 1, TO]
            node[v, TO] += node[v, FROM]
        node[v, LOWER] = lower
        node[v, UPPER] = upper
    node[n, UPPER] = n
    return node


@jit
def _near(edge: I64, node: I64, by_length: I64) -> I64:
    """The edges at each vertex by rising length, in the ranges that `node` names."""
    near = np.empty(2 * len(by_length), np.int64)
    for e in by_length:
        for p in range(2):
            v = edge[e, p]
            # nothing is chosen yet: the degrees count what has been filled in
            near[node[v, FROM] + node[v, DEGREE]] = e
            node[v, DEGREE] += 1
    for v in range(node.shape[0] - 1):
        node[v, DEGREE] = 0
    return near


def nearest_in_interiors(points: F64, order: I64, first: I64, meetings: I64, faces: I64) -> tuple[I32, I8]:
    """For every face pore, on every side where it meets an interior, the nearest pore of that interior.

    `order` (n,) are the pores by piece, where each begins at `first` (pieces + 1,). `meetings` (p, 4) are rows
    (interior, axis, side, color) as in `Palette`, and `faces` (p,) the piece of the face pattern of each. Returns edges
    (m, 2) from interior pore to face pore, the first in `order` of equally near ones, none where an interior or a face
    has no pores; and whole cells (m, 3) by which the face pore is moved.
    """
    there = first[meetings[:, 0] + 1] > first[meetings[:, 0]]
    number = int(((first[faces + 1] - first[faces]) * there).sum())
    edges, shifts = np.empty((number, 2), np.int32), np.zeros((number, 3), np.int8)
    _nearest(points, order, first, meetings, faces, edges, shifts)
    return edges, shifts


@jit
def _nearest(points: F64, order: I64, first: I64, meetings: I64, faces: I64, edges: I32, shifts: I8) -> None:
    row = 0
    for meeting in range(len(faces)):
        inside, face = meetings[meeting, 0], faces[meeting]
        if first[inside] == first[inside + 1]:
            continue
        axis, side = meetings[meeting, 1], meetings[meeting, 2]
        for f in range(first[face], first[face + 1]):
            x, y, z = points[order[f], 0], points[order[f], 1], points[order[f], 2]
            x += side * (axis == 0)
            y += side * (axis == 1)
            z += side * (axis == 2)
            best = np.inf
            for s in range(first[inside], first[inside + 1]):
                i = order[s]
                dx, dy, dz = x - points[i, 0], y - points[i, 1], z - points[i, 2]
                d = dx * dx + dy * dy + dz * dz
                if d < best:
                    best = d
                    edges[row, 0] = i
            edges[row, 1] = order[f]
            shifts[row, axis] = side
            row += 1
