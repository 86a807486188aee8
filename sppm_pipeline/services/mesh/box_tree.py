"""A tree of boxes around triangles: what is near, what a ray hits, and how far the sum of far triangles may be taken.

The triangles are put in the order of a space-filling curve (Morton 1966) and cut into equal runs, the leaves of a
balanced binary tree that needs no pointers: the children of node i are 2 i + 1 and 2 i + 2, and the leaves are the last
row. Building costs a sort; the tree belongs to the data alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64, U64
from sppm_pipeline.services.jit.compiled import jit

DEPTH = 64
"""Room for the nodes that a walk has still to visit: one a level, and two on the last."""

_LEAF = 4  # triangles in a leaf, at most


class BoxTree(NamedTuple):
    """The tree, and the triangles in its order."""

    order: I64  # (m,): place i of the tree holds triangle order[i] of the mesh
    triangles: F64  # (m, 3, 3) corners, in the order of the tree
    boxes: F64  # (2 leaves - 1, 6), low and high corner; without triangles the low one is at infinity
    starts: I64  # (leaves + 1,): leaf k holds the places starts[k] to starts[k + 1]


def box_tree(triangles: F64) -> BoxTree:
    """Build the tree of triangles (m, 3, 3), at least one, with finite coordinates."""
    if triangles.shape[0] == 0:
        raise ValueError("a tree needs a triangle")
    # half the sum of low and high corner is in the box even where the full sum would overflow
    middles = triangles.min(axis=1) / 2 + triangles.max(axis=1) / 2
    low = middles.min(axis=0)
    extent = float((middles - low).max())
    order = np.argsort(_morton(middles, low, extent if extent > 0 else 1.0), kind="stable")
    leaves = 1
    while leaves * _LEAF < len(order):
        leaves *= 2
    starts = np.arange(leaves + 1) * len(order) // leaves
    ordered = np.ascontiguousarray(triangles[order], np.float64)
    return BoxTree(order, ordered, _boxes(ordered, starts), starts)


@jit
def _morton(points: F64, low: F64, extent: float) -> U64:
    """The bits of the three coordinates, 21 each, one after the other."""
    codes = np.zeros(points.shape[0], np.uint64)
    for i in range(points.shape[0]):
        code = np.uint64(0)
        for a in range(3):
            # 2^21 - 1: three coordinates of 21 bits fill a word of 64
            bits = np.uint64((points[i, a] - low[a]) / extent * 2097151.0)
            for b in range(21):
                code |= (bits >> np.uint64(b) & np.uint64(1)) << np.uint64(3 * b + a)
        codes[i] = code
    return codes


@jit
def _boxes(triangles: F64, starts: I64) -> F64:
    leaves = starts.size - 1
    boxes = np.empty((2 * leaves - 1, 6))
    # from the leaves up: the children of a node come after it
    for node in range(2 * leaves - 2, -1, -1):
        for a in range(3):
            low, high = np.inf, -np.inf
            if node >= leaves - 1:
                leaf = node - leaves + 1
                for i in range(starts[leaf], starts[leaf + 1]):
                    for c in range(3):
                        low, high = min(low, triangles[i, c, a]), max(high, triangles[i, c, a])
            else:
                for child in (2 * node + 1, 2 * node + 2):
                    low, high = min(low, boxes[child, a]), max(high, boxes[child, a + 3])
            boxes[node, a] = low
            boxes[node, a + 3] = high
    return boxes
