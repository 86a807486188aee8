"""The candidate graph: each pore and its k nearest neighbors, made connected by the shortest bridging edges."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.connecting.trees import (
    as_points,
    canonical_edges,
    component_labels,
    find_root,
    nearest_shifts,
    periodic_axes,
    squared_distance,
    wrapped,
)


def candidate_graph(
    points: ArrayLike, k: int = 10, *, periodic: bool | Sequence[bool] = False
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Edges from each pore to its k nearest neighbors, in both senses, plus the shortest edges that connect them.

    On periodic axes (period 1) every image of a pore counts as a neighbor of its own, as long as the edge is not
    longer than the cell along that axis; so two pores may be joined several times when there are few of them. A pore
    is never joined to an image of itself. Equally near neighbors are taken by index, then by shift. If the graph
    falls apart, its components are joined as in Boruvka's algorithm, twice: the second time by edges that avoid the
    ends of the first, so that a bounded degree or a second path is not ruled out.

    Parameters
    ----------
    points : (n, 3) float64
        Pore centers; the unit is the cell size if an axis is periodic.
    k : int
        Neighbors of each pore.
    periodic : bool or 3 bools
        Whether the axes repeat with period 1.

    Returns
    -------
    edges : (m, 2) int64
        Pairs i < j, sorted by (i, j, shift).
    shifts : (m, 3) int64
        The edge runs from ``points[i]`` to ``points[j] + shift``.
    """
    points = as_points(points)
    if k < 1:
        raise ValueError(f"k must be at least 1, not {k}")
    axes = periodic_axes(periodic)
    n = len(points)
    if n < 2:
        return np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64)
    inside, cells = wrapped(points, axes)
    # at most 27 images of each other pore can be a neighbor; more slots would only stay empty
    slots = min(k, (n - 1) * 27)
    # sweeping along the widest axis visits the minimum pores that are not neighbors
    axis = int(np.argmax(np.ptp(inside, axis=0)))
    order = np.argsort(inside[:, axis], kind="stable")
    neighbors, codes = _nearest(inside, axes, order, axis, slots)
    keys = np.unique(neighbors.ravel()[neighbors.ravel() >= 0] * 27 + codes.ravel()[neighbors.ravel() >= 0])
    pairs, image = np.divmod(keys, 27)
    edges = np.stack(np.divmod(pairs, n), axis=1)
    shifts = np.stack([image // 9 - 1, image // 3 % 3 - 1, image % 3 - 1], axis=1)
    shifts += cells[edges[:, 0]] - cells[edges[:, 1]]
    labels = component_labels(n, edges)
    if labels.max() == 0:
        return edges, shifts
    first = _bridging(inside, axes, labels, np.zeros(n, np.bool_))
    used = np.zeros(n, np.bool_)
    used[first] = True
    alone = np.bincount(labels, weights=~used)[labels] == 0
    second = _bridging(inside, axes, labels, used & ~alone)
    bridging = np.concatenate([first, second])
    return canonical_edges(
        np.concatenate([edges, bridging]),
        np.concatenate([shifts, nearest_shifts(inside, cells, axes, bridging)]),
    )


@jit
def _nearest(
    inside: NDArray[np.float64], axes: NDArray[np.bool_], order: NDArray[np.int64], axis: int, k: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pair key min(i, j) * n + max(i, j) and image code of the k nearest images of each pore; -1 in empty slots.

    The pores are visited outwards along `axis`, image after image, until none can be nearer than the k-th best.
    """
    n = inside.shape[0]
    pairs = np.full((n, k), -1, np.int64)
    codes = np.zeros((n, k), np.int64)
    best = np.empty(k)
    who = np.empty(k, np.int64)
    how = np.empty(k, np.int64)
    other = np.empty(2, np.int64)
    other[0] = 1 if axis == 0 else 0
    other[1] = 1 if axis == 2 else 2
    power = np.array([9, 3, 1])
    for r in range(n):
        i = order[r]
        count = 0
        ahead, behind = r + 1, r - 1
        while True:
            gap, take = np.inf, 0
            for sense in (1, -1):
                q = ahead if sense == 1 else behind
                if axes[axis] or (0 <= q < n):
                    turn = q // n
                    g = abs(inside[order[q - turn * n], axis] - inside[i, axis] + turn)
                    if g < gap:
                        gap, take = g, sense
            if take == 0 or (axes[axis] and gap > 1.0) or (count == k and gap * gap > best[k - 1]):
                break
            q = ahead if take == 1 else behind
            turn = q // n
            j = order[q - turn * n]
            if take == 1:
                ahead += 1
            else:
                behind -= 1
            if j == i:
                continue
            u = inside[j, other[0]] - inside[i, other[0]]
            v = inside[j, other[1]] - inside[i, other[1]]
            near_u = u - np.rint(u) if axes[other[0]] else u
            near_v = v - np.rint(v) if axes[other[1]] else v
            if count == k and gap * gap + near_u * near_u + near_v * near_v > best[k - 1]:
                continue
            for su in range(-1, 2):
                du = u + su
                if (axes[other[0]] and abs(du) > 1.0) or (not axes[other[0]] and su != 0):
                    continue
                for sv in range(-1, 2):
                    dv = v + sv
                    if (axes[other[1]] and abs(dv) > 1.0) or (not axes[other[1]] and sv != 0):
                        continue
                    d = gap * gap + du * du + dv * dv
                    code = (turn + 1) * power[axis] + (su + 1) * power[other[0]] + (sv + 1) * power[other[1]]
                    if count < k:
                        slot = count
                        count += 1
                    elif d < best[k - 1] or (d == best[k - 1] and (j, code) < (who[k - 1], how[k - 1])):
                        slot = k - 1
                    else:
                        continue
                    while slot > 0 and (
                        d < best[slot - 1] or (d == best[slot - 1] and (j, code) < (who[slot - 1], how[slot - 1]))
                    ):
                        best[slot], who[slot], how[slot] = best[slot - 1], who[slot - 1], how[slot - 1]
                        slot -= 1
                    best[slot], who[slot], how[slot] = d, j, code
        for s in range(count):
            pairs[i, s] = min(i, who[s]) * n + max(i, who[s])
            # seen from the other end the image lies the other way
            codes[i, s] = how[s] if i < who[s] else 26 - how[s]
    return pairs, codes


@jit
def _bridging(
    inside: NDArray[np.float64], axes: NDArray[np.bool_], labels: NDArray[np.int64], skipped: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """The shortest edges (to nearest images) that join the labeled components into one, avoiding skipped vertices."""
    n = inside.shape[0]
    count = labels.max() + 1
    parent = np.arange(count)
    edges = np.empty((count - 1, 2), np.int64)
    m = 0
    while m < count - 1:
        best = np.full(count, np.inf)
        ends = np.zeros((count, 2), np.int64)
        for i in range(n):
            if skipped[i]:
                continue
            a = find_root(parent, labels[i])
            for j in range(i + 1, n):
                if skipped[j]:
                    continue
                b = find_root(parent, labels[j])
                if a == b:
                    continue
                d = squared_distance(inside, axes, i, j)
                # pairs come in rising order, so that "less" leaves ties with the lower pair
                if d < best[a]:
                    best[a] = d
                    ends[a, 0], ends[a, 1] = i, j
                if d < best[b]:
                    best[b] = d
                    ends[b, 0], ends[b, 1] = i, j
        for c in range(count):
            if best[c] < np.inf:
                a = find_root(parent, labels[ends[c, 0]])
                b = find_root(parent, labels[ends[c, 1]])
                if a != b:
                    parent[max(a, b)] = min(a, b)
                    edges[m, 0], edges[m, 1] = ends[c, 0], ends[c, 1]
                    m += 1
    return edges
