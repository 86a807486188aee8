"""Which triangles of a mesh run into others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.meshcheck.box_tree import DEPTH, BoxTree
from sppm_pipeline.numerics.meshcheck.triangle_pair import is_flat, triangles_meet

MOST_PAIRS = 200_000_000
"""Pairs with overlapping boxes that are looked at; then the search is given up, for it would not end in time."""

_LEAVES_AT_ONCE = 4096


class SelfIntersections(NamedTuple):
    """What `self_intersections` finds.

    Attributes
    ----------
    faces : (m,) bool
        Triangles that meet another one beyond shared corners and edges, be it that they cross, touch or overlap.
    pairs : int
        Pairs of such triangles.
    complete : bool
        False if the search was given up.
    """

    faces: NDArray[np.bool_]
    pairs: int
    complete: bool


def self_intersections(tree: BoxTree, most_pairs: int = MOST_PAIRS) -> SelfIntersections:
    """Find the triangles that run into others, by exact predicates.

    Flat triangles are left out. Corners with equal coordinates are one, whatever their numbers.

    Parameters
    ----------
    tree : BoxTree
    most_pairs : int
        Give up after so many pairs whose boxes overlap. Ordinary meshes have about ten a triangle.
    """
    marked = np.zeros(len(tree.order), np.bool_)
    flat = _flat(tree.triangles)
    leaves = tree.starts.size - 1
    pairs, tried = 0, 0
    for first in range(0, leaves, _LEAVES_AT_ONCE):
        last = min(leaves, first + _LEAVES_AT_ONCE)
        found, more = _pairs(tree.triangles, tree.boxes, tree.starts, flat, first, last, most_pairs - tried, marked)
        pairs += int(found)
        tried += int(more)
        if tried >= most_pairs:
            break
    faces = np.zeros_like(marked)
    faces[tree.order] = marked
    return SelfIntersections(faces, pairs, tried < most_pairs)


@jit
def _flat(triangles: NDArray[np.float64]) -> NDArray[np.bool_]:
    flat = np.empty(triangles.shape[0], np.bool_)
    for i in range(triangles.shape[0]):
        flat[i] = is_flat(triangles[i])
    return flat


@jit
def _apart(triangles: NDArray[np.float64], i: int, j: int) -> bool:
    """Whether the boxes of two triangles do not even touch."""
    t, s = triangles[i], triangles[j]
    for a in range(3):
        if min(t[0, a], t[1, a], t[2, a]) > max(s[0, a], s[1, a], s[2, a]):
            return True
        if max(t[0, a], t[1, a], t[2, a]) < min(s[0, a], s[1, a], s[2, a]):
            return True
    return False


@jit
def _pairs(
    triangles: NDArray[np.float64],
    boxes: NDArray[np.float64],
    starts: NDArray[np.int64],
    flat: NDArray[np.bool_],
    first: int,
    last: int,
    most: int,
    marked: NDArray[np.bool_],
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
        if tried >= most:
            break
    return pairs, tried
