"""Pores in two colors, each of them one connected network.

Which pores are neighbors is given as pairs. Half of the pores are of either color; neighbors of different colors are
exchanged as long as that brings both nearer to the share of neighbors of their own color that they should have. A few
pores that are left without a way to the others of their color take the color around them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.union_find import find_root, unite

OWN_SHARE = 0.42
"""Share of a pore's neighbors that are of its own color: with less, networks break up, with more they clump."""

_SWEEPS = 30
"""Tries to exchange each pore; most settle within ten."""


def two_networks(pairs: I64, count: int, rng: np.random.Generator) -> NDArray[np.int8]:
    """Colors 1 and -1 of so many pores, (count,), of which each is one network, where the neighbors (m, 2) allow it.

    Pores that are not connected by neighbors have networks of their own, two in each part.
    """
    colors = np.ones(count, np.int8)
    colors[rng.permutation(count)[: count // 2]] = -1
    ends = np.concatenate([pairs, pairs[:, ::-1]])
    order = np.argsort(ends[:, 0], kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(ends[:, 0], minlength=count))]).astype(np.int64)
    neighbors = np.ascontiguousarray(ends[order, 1], np.int64)
    for _ in range(_SWEEPS):
        choice = rng.random((count, 2))
        if not _exchange(first, neighbors, colors, rng.permutation(count), choice[:, 0].copy(), OWN_SHARE):
            break
    _unite_colors(first, neighbors, colors)
    return colors


@jit
def _excess(first: I64, neighbors: I64, colors: NDArray[np.int8], i: int, share: float) -> float:
    """Square of what a pore has more or less than its share of neighbors of its own color."""
    degree, own = first[i + 1] - first[i], 0
    for k in range(first[i], first[i + 1]):
        if colors[neighbors[k]] == colors[i]:
            own += 1
    if degree == 0:
        return 0.0
    off: float = own / degree - share
    return off * off


@jit
def _around(first: I64, neighbors: I64, colors: NDArray[np.int8], i: int, j: int, share: float) -> float:
    """Sum of `_excess` over two pores and their neighbors; who is a neighbor of both counts twice, before and after."""
    total = _excess(first, neighbors, colors, i, share) + _excess(first, neighbors, colors, j, share)
    for k in range(first[i], first[i + 1]):
        total += _excess(first, neighbors, colors, neighbors[k], share)
    for k in range(first[j], first[j + 1]):
        total += _excess(first, neighbors, colors, neighbors[k], share)
    return total


@jit
def _exchange(
    first: I64, neighbors: I64, colors: NDArray[np.int8], order: I64, choice: NDArray[np.float64], share: float
) -> int:
    """One try for each pore to exchange its color with a neighbor; how many did."""
    changed = 0
    for i in order:
        degree = first[i + 1] - first[i]
        if degree == 0:
            continue
        j = neighbors[first[i] + min(int(choice[i] * degree), degree - 1)]
        if colors[i] == colors[j]:
            continue
        before = _around(first, neighbors, colors, i, j, share)
        colors[i], colors[j] = colors[j], colors[i]
        if _around(first, neighbors, colors, i, j, share) < before:
            changed += 1
        else:
            colors[i], colors[j] = colors[j], colors[i]
    return changed


@jit
def _unite_colors(first: I64, neighbors: I64, colors: NDArray[np.int8]) -> None:
    """Give all but the largest part of each color, among connected pores, the other color, until none is left.

    What turns joins the parts around it, and leaves the largest of its color whole, so there are fewer parts each time.
    """
    n = len(colors)
    parent, body = np.empty(n, np.int64), np.empty(n, np.int64)
    size, largest = np.empty(n, np.int64), np.empty((n, 2), np.int64)
    for i in range(n):
        body[i] = i
    for i in range(n):
        for k in range(first[i], first[i + 1]):
            unite(body, i, neighbors[k])
    turned = True
    while turned:
        turned = False
        for i in range(n):
            parent[i], size[i], largest[i, 0], largest[i, 1] = i, 0, -1, -1
        for i in range(n):
            for k in range(first[i], first[i + 1]):
                if colors[neighbors[k]] == colors[i]:
                    unite(parent, i, neighbors[k])
        for i in range(n):
            size[find_root(parent, i)] += 1
        for i in range(n):
            if find_root(parent, i) == i:
                whole, side = find_root(body, i), 0 if colors[i] < 0 else 1
                best = largest[whole, side]
                if best < 0 or size[i] > size[best]:
                    largest[whole, side] = i
        color = 0  # of one color at a time: two small parts side by side would only change places
        for i in range(n):
            root = find_root(parent, i)
            whole = find_root(body, i)
            if root != largest[whole, 0] and root != largest[whole, 1] and (color == 0 or colors[i] == color):
                color = colors[i]
                colors[i] = -colors[i]
                turned = True
