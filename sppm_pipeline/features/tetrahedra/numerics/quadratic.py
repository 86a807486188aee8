"""Quadratic tetrahedra: nodes in the middle of the edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)], np.int64)
"""Corners at the ends of the edges, in the order of their nodes."""


def with_mid_nodes(
    nodes: NDArray[np.floating], tets: NDArray[np.integer]
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Add a node in the middle of each edge, which the tetrahedra at the edge share.

    Of nodes (n, 3) and tets (m, 4); nodes become (n + edges, 3) float64, the old ones first, and tets (m, 10) int32:
    corners, then the nodes on the edges 01, 12, 02, 03, 13, 23.
    """
    points = np.asarray(nodes, np.float64)
    ends = np.sort(np.asarray(tets, np.int64)[:, EDGES], axis=2)
    # an edge as one number, which sorts much faster than rows of two
    edges, number = np.unique(ends[..., 0] * len(points) + ends[..., 1], return_inverse=True)
    first, second = np.divmod(edges, max(1, len(points)))
    middles = (points[first] + points[second]) / 2
    cells = np.concatenate([tets, len(points) + number.reshape(len(ends), 6)], axis=1)
    return np.concatenate([points, middles]), cells.astype(np.int32)


def minimum_jacobian(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> NDArray[np.float64]:
    """The smallest Jacobian determinant of each quadratic tetrahedron (m, 10) at its ten nodes, (m,).

    Six times the volume for one with straight edges and nodes in their middles. Positive values at the nodes do not
    prove that it is positive in between, but that is where curved edges fail first.
    """
    corners = np.array([(0.0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    places = np.concatenate([corners, corners[EDGES].mean(1)])
    slope = np.array([(-1.0, -1, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
    points = np.asarray(nodes, np.float64)[tets]
    least = np.full(len(points), np.inf)
    for place in places:
        weights = np.array([1 - place.sum(), *place])
        gradient = np.concatenate(
            [
                (4 * weights[:, None] - 1) * slope,
                4 * (weights[EDGES[:, 0], None] * slope[EDGES[:, 1]] + weights[EDGES[:, 1], None] * slope[EDGES[:, 0]]),
            ]
        )
        np.minimum(least, np.linalg.det(np.einsum("mni,nj->mij", points, gradient)), out=least)
    return least
