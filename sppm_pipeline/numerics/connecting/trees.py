"""Minimum spanning trees: Prim over all pairs, Kruskal and components by union-find over given edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connecting.images import as_points, canonical_edges, periodic_axes, wrapped


def minimum_spanning_tree(
    points: ArrayLike, *, periodic: bool | Sequence[bool] = False
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The exact Euclidean minimum spanning tree, with every pore at its nearest image on the periodic axes.

    Prim's algorithm over all pairs, O(n^2) time and O(n) memory: a nearest-neighbor graph may miss an edge of the
    tree, all pairs can't. Of equally short edges the one to the lower index is taken.

    Parameters
    ----------
    points : (n, 3) float64
        Pore centers; the unit is the cell edge if an axis is periodic.
    periodic : bool or 3 bools
        Whether the axes repeat with period 1.

    Returns
    -------
    edges : (n - 1, 2) int64
        Pairs i < j, sorted.
    shifts : (n - 1, 3) int64
        The edge runs from ``points[i]`` to ``points[j] + shift``.
    """
    points = as_points(points)
    axes = periodic_axes(periodic)
    if len(points) < 2:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    inside, cells = wrapped(points, axes)
    edges = _prim(inside, axes)
    return canonical_edges(edges, nearest_shifts(inside, cells, axes, edges))


def nearest_shifts(
    inside: NDArray[np.float64], cells: NDArray[np.int64], axes: NDArray[np.bool_], edges: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Shifts (m, 3) of the edges to the nearest image, from what `wrapped` returned."""
    i, j = edges[:, 0], edges[:, 1]
    nearest = np.where(axes, -np.rint(inside[j] - inside[i]), 0.0).astype(np.int64)
    return nearest + cells[i] - cells[j]


@jit
def squared_distance(inside: NDArray[np.float64], axes: NDArray[np.bool_], i: int, j: int) -> float:
    """Squared distance of i from the nearest image of j."""
    total = 0.0
    for a in range(3):
        step = inside[j, a] - inside[i, a]
        if axes[a]:
            step -= np.rint(step)
        total += step * step
    return total


@jit
def _prim(inside: NDArray[np.float64], axes: NDArray[np.bool_]) -> NDArray[np.int64]:
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
                d = squared_distance(inside, axes, last, j)
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
def find_root(parent: NDArray[np.int64], i: int) -> int:
    """Root of i in a union-find forest; halves the path on its way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@jit
def kruskal(n: int, edges: NDArray[np.int64], order: NDArray[np.int64]) -> NDArray[np.int64]:
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


@jit
def component_labels(n: int, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Component of every vertex, (n,) int64, numbered 0, 1, ... in the order of their lowest vertex."""
    parent = np.arange(n)
    for e in range(edges.shape[0]):
        a = find_root(parent, edges[e, 0])
        b = find_root(parent, edges[e, 1])
        if a != b:
            parent[max(a, b)] = min(a, b)
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
