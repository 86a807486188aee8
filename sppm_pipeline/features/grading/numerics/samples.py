"""Interpolation of values at points and nodes: inverse distances, elements as tetrahedra, smoothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

NEIGHBORS, POWER = 8, 2
"""Points of a mean by inverse distances, and the power of the distance: Shepard (1968) recommends four to ten points
and the square."""

CORNERS = {
    "tetra": 4, "tetra10": 4, "hexahedron": 8, "hexahedron20": 8, "hexahedron27": 8, "wedge": 6, "wedge15": 6,
    "pyramid": 5, "pyramid13": 5,
}  # fmt: skip
"""Solid elements that are read, and their corner nodes, which come first; others are nodes on edges and faces."""

_SPLITS: Mapping[int, list[list[int]]] = {
    4: [[0, 1, 2, 3]],
    5: [[0, 1, 2, 4], [0, 2, 3, 4]],
    6: [[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]],
    8: [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]],
}
"""Tetrahedra that fill an element, by its number of corners; those of a hexahedron share a diagonal."""

MAX_PAIRS = 200_000_000
"""Pairs of nodes that smoothing sums over; a tenth of a microsecond each."""


def by_inverse_distance(tree: Any, values: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of the nearest samples by inverse squared distances; at a sample its own value."""
    count = min(NEIGHBORS, len(values))
    distance, near = tree.query(points, count)
    distance, near = distance.reshape(len(points), count), near.reshape(len(points), count)
    there = distance[:, 0] == 0
    # relative to the nearest one, so that nothing overflows
    weights = (np.where(there, 1.0, distance[:, 0])[:, None] / np.where(distance > 0, distance, 1.0)) ** POWER
    weights[there] = np.where(distance[there] == 0, 1.0, 0.0)
    means: NDArray[np.float64] = (weights * values[near]).sum(axis=1) / weights.sum(axis=1)
    return means


def as_tetrahedra(blocks: list[tuple[str, NDArray[np.int64]]]) -> NDArray[np.int64]:
    """Corner nodes (m, 4) of tetrahedra that fill solid elements; each block is a type and its nodes (k, nodes)."""
    parts = []
    for kind, nodes in blocks:
        split = np.array(_SPLITS[CORNERS[kind]])
        parts.append(nodes[:, split].reshape(-1, 4))
    return np.concatenate(parts) if parts else np.zeros((0, 4), np.int64)


def tetrahedra_of(blocks: list[tuple[str, NDArray[np.int64]]]) -> NDArray[np.int64]:
    """Number of tetrahedra that `as_tetrahedra` makes of each element, (elements,)."""
    return np.concatenate([np.full(len(nodes), len(_SPLITS[CORNERS[kind]])) for kind, nodes in blocks])


def volumes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Volumes (m,) of tetrahedra (m, 4, 3)."""
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    found: NDArray[np.float64] = np.abs(np.einsum("ij,ij->i", np.cross(a, b), c)) / 6
    return found


def at_nodes(
    tetrahedra: NDArray[np.int64], volume: NDArray[np.float64], values: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Values of tetrahedra as means at the nodes, weighted by volume: (count,), NaN at nodes of no element."""
    nodes, weights = tetrahedra.ravel(), np.repeat(volume, 4)
    total = np.bincount(nodes, weights, count)
    with np.errstate(invalid="ignore", divide="ignore"):
        means: NDArray[np.float64] = np.bincount(nodes, weights * np.repeat(values, 4), count) / total
    return means


def smoothed(
    nodes: NDArray[np.float64], weights: NDArray[np.float64], values: NDArray[np.float64], sigma: float
) -> NDArray[np.float64]:
    """Means of nodal values, weighted by a Gaussian of the distance and by the nodes' volumes.

    The Gaussian has the standard deviation `sigma`, and is cut off at three of them; the `weights` are the nodes'
    volumes, a quarter of those of their tetrahedra. `ValueError` if so many nodes lie within reach of each other that
    it would take very long.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(nodes)
    pairs = int(tree.count_neighbors(tree, 3 * sigma))
    if pairs > MAX_PAIRS:
        raise ValueError(f"{pairs:.2g} pairs of nodes lie within 3 x {sigma:g} of each other; up to {MAX_PAIRS:.0e} do")
    # some four million pairs at a time, for memory
    step = max(1, int(len(nodes) * 4e6 / max(pairs, 1)))
    means = np.empty(len(nodes))
    for start in range(0, len(nodes), step):
        own = cKDTree(nodes[start : start + step])
        near = own.sparse_distance_matrix(tree, 3 * sigma, output_type="ndarray")
        # in a fixed order, so that sums do not depend on how the tree was walked
        near = near[np.lexsort((near["j"], near["i"]))]
        share = np.exp(-0.5 * (near["v"] / sigma) ** 2) * weights[near["j"]]
        count = len(own.data)
        total = np.bincount(near["i"], share, count)
        means[start : start + count] = np.bincount(near["i"], share * values[near["j"]], count) / total
    return means
