"""Self-intersections of a mesh: pairs of triangles that meet elsewhere than in shared corners and edges.

Decided without rounding errors. Two triangles meet if and only if an edge of one meets the other. If they share a
corner, it is enough to look at the edges opposite to it: where triangles meet in more than the corner, they meet along
a line from it, and that ends on an opposite edge. If they share an edge, they must lie in one plane, on the same side
of it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree
from sppm_pipeline.services.mesh.predicates import side_of_line, side_of_plane

MAX_PAIRS = 200_000_000
"""Pairs with overlapping boxes that are looked at; then the search is given up, for it would not end in time."""

_LEAVES_AT_ONCE = 4096


class SelfIntersections(NamedTuple):
    """The result of `self_intersections`."""

    faces: Bools  # (m,), triangles that cross, touch or overlap another one beyond shared corners and edges
    pairs: int  # pairs of such triangles
    complete: bool  # False if the search was given up


def self_intersections(tree: BoxTree, max_pairs: int = MAX_PAIRS) -> SelfIntersections:
    """Find the triangles that run into others, by exact predicates.

    Flat triangles are left out. Corners with equal coordinates are one, whatever their numbers. The search is given up
    after `max_pairs` pairs whose boxes overlap; ordinary meshes have about ten a triangle.
    """
    marked = np.zeros(len(tree.order), np.bool_)
    flat = _flat(tree.triangles)
    leaves = tree.starts.size - 1
    pairs, tried = 0, 0
    for first in range(0, leaves, _LEAVES_AT_ONCE):
        last = min(leaves, first + _LEAVES_AT_ONCE)
        found, more = _pairs(tree.triangles, tree.boxes, tree.starts, flat, first, last, max_pairs - tried, marked)
        pairs += int(found)
        tried += int(more)
        if tried >= max_pairs:
            break
    faces = np.zeros_like(marked)
    faces[tree.order] = marked
    return SelfIntersections(faces, pairs, tried < max_pairs)


@jit
def _flat(triangles: F64) -> Bools:
    flat = np.empty(triangles.shape[0], np.bool_)
    for i in range(triangles.shape[0]):
        flat[i] = is_flat(triangles[i])
    return flat


@jit
def _apart(triangles: F64, i: int, j: int) -> bool:
    """Test whether the boxes of two triangles do not even touch."""
    t, s = triangles[i], triangles[j]
    for a in range(3):
        if min(t[0, a], t[1, a], t[2, a]) > max(s[0, a], s[1, a], s[2, a]):
            return True
        if max(t[0, a], t[1, a], t[2, a]) < min(s[0, a], s[1, a], s[2, a]):
            return True
    return False


@jit
def _pairs(
    triangles: F64, boxes: F64, starts: I64, flat: Bools, first: int, last: int, max_pairs: int, marked: Bools
) -> tuple[int, int]:
    """Pairs of triangles in leaves first to last with those in the same leaf or later ones."""
    leaves = starts.size - 1
    waiting = np.empty(DEPTH, np.int64)
    pairs, tried = 0, 0
    for leaf in range(first, last):
        box = boxes[leaf + leaves - 1]
        waiting[0] = 0
        left = 1
        while left > 0:
            left -= 1
            node = waiting[left]
            other = boxes[node]
            if (
                other[0] > box[3]
                or other[3] < box[0]
                or other[1] > box[4]
                or other[4] < box[1]
                or other[2] > box[5]
                or other[5] < box[2]
            ):
                continue
            if node < leaves - 1:
                # a subtree that lies before the leaf met it already
                deepest = 2 * node + 2
                while deepest < leaves - 1:
                    deepest = 2 * deepest + 2
                if deepest >= leaf + leaves - 1:
                    waiting[left] = 2 * node + 2
                    waiting[left + 1] = 2 * node + 1
                    left += 2
                continue
            k = node - leaves + 1
            if k < leaf:
                continue
            for i in range(starts[leaf], starts[leaf + 1]):
                if flat[i]:
                    continue
                for j in range(i + 1 if k == leaf else starts[k], starts[k + 1]):
                    if flat[j] or _apart(triangles, i, j):
                        continue
                    tried += 1
                    if triangles_meet(triangles[i], triangles[j]):
                        pairs += 1
                        marked[i] = True
                        marked[j] = True
        if tried >= max_pairs:
            break
    return pairs, tried


@jit
def is_flat(t: F64) -> bool:
    """Test exactly whether the corners of a triangle (3, 3) lie on one line."""
    return _projection(t) < 0


@jit
def _projection(t: F64) -> int:
    """The axis along which the triangle is seen as an area; -1 if it has none."""
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        if side_of_line(t[0, i], t[0, j], t[1, i], t[1, j], t[2, i], t[2, j]) != 0:
            return axis
    return -1


@jit
def _meets_in_plane(p: F64, q: F64, t: F64) -> bool:
    """Test whether segment pq, in the plane of triangle t, meets it."""
    axis = _projection(t)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    p_low, p_high, q_low, q_high = 1, -1, 1, -1
    for e in range(3):
        a, b = t[e], t[(e + 1) % 3]
        of_p = side_of_line(a[i], a[j], b[i], b[j], p[i], p[j])
        of_q = side_of_line(a[i], a[j], b[i], b[j], q[i], q[j])
        p_low, p_high = min(p_low, of_p), max(p_high, of_p)
        q_low, q_high = min(q_low, of_q), max(q_high, of_q)
        # an edge on one line with pq needs no care: then pq meets its neighbors too, or ends in the triangle
        if of_p * of_q <= 0 and (of_p != 0 or of_q != 0):
            of_a = side_of_line(p[i], p[j], q[i], q[j], a[i], a[j])
            of_b = side_of_line(p[i], p[j], q[i], q[j], b[i], b[j])
            if of_a * of_b <= 0:
                return True
    return p_low >= 0 or p_high <= 0 or q_low >= 0 or q_high <= 0


@jit
def _segment_meets(p: F64, q: F64, of_p: int, of_q: int, t: F64) -> bool:
    """Test whether segment pq meets triangle t; given are the sides of its plane on which p and q lie."""
    if of_p * of_q > 0:
        return False
    if of_p == 0 and of_q == 0:
        return _meets_in_plane(p, q, t)
    low, high = 1, -1
    for e in range(3):
        turn = side_of_plane(p, q, t[e], t[(e + 1) % 3])
        low, high = min(low, turn), max(high, turn)
        if low < 0 and high > 0:
            return False
    return True


@jit
def triangles_meet(t: F64, s: F64) -> bool:
    """Test whether two triangles (3, 3), neither of them flat, meet beyond the corners they share.

    Corners are shared if their coordinates are equal. Triangles that share all three lie on each other: they meet.
    """
    shared = 0
    of_t, of_s = np.full(3, -1, np.int64), np.full(3, -1, np.int64)  # the corner of the other triangle
    for i in range(3):
        for j in range(3):
            if t[i, 0] == s[j, 0] and t[i, 1] == s[j, 1] and t[i, 2] == s[j, 2]:
                of_t[i], of_s[j] = j, i
                shared += 1
    # the same corners: they lie on each other
    if shared == 3:
        return True
    sides_s, sides_t = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for which in range(2):
        low, high = 1, -1
        for i in range(3):
            if which == 0 and of_s[i] < 0:
                side = side_of_plane(t[0], t[1], t[2], s[i])
                sides_s[i] = side
            elif which == 1 and of_t[i] < 0:
                side = side_of_plane(s[0], s[1], s[2], t[i])
                sides_t[i] = side
            else:
                continue
            low, high = min(low, side), max(high, side)
        if low > 0 or high < 0:
            return False
    # with a shared edge: they overlap only in one plane, with both third corners on one side of the edge
    if shared == 2:
        i, j = 0, 0
        while of_t[i] >= 0:
            i += 1
        while of_s[j] >= 0:
            j += 1
        if sides_s[j] != 0:
            return False
        axis = _projection(t)
        x, y = (axis + 1) % 3, (axis + 2) % 3
        a, b = t[(i + 1) % 3], t[(i + 2) % 3]
        one = side_of_line(a[x], a[y], b[x], b[y], t[i, x], t[i, y])
        return one == side_of_line(a[x], a[y], b[x], b[y], s[j, x], s[j, y])
    for c in range(3):
        # edge c runs from corner c + 1 to corner c + 2, opposite to corner c
        p, q = (c + 1) % 3, (c + 2) % 3
        if (shared == 0 or of_t[c] >= 0) and _segment_meets(t[p], t[q], sides_t[p], sides_t[q], s):
            return True
        if (shared == 0 or of_s[c] >= 0) and _segment_meets(s[p], s[q], sides_s[p], sides_s[q], t):
            return True
    return False
