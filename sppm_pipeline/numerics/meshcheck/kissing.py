"""Vertices at one place that belong to different sheets, moved apart.

Where two tips touch, a mesh that is a manifold by its indices has two vertices at one place. A file that keeps no
indices (STL), or a reader that merges vertices by place, makes one of them, and of two edges one edge of four
triangles.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

STEP = 2.0**-8
"""How far a vertex is moved, as a share of the way to the middle of its neighbors."""


def kissing_vertices(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of the vertices (n, 3) that share their place, in single precision, with another one."""
    _, place, count = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True, return_counts=True)
    return np.flatnonzero(count[place.reshape(-1)] > 1)


def parted_vertices(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The vertices, those that kiss drawn back a little towards their own neighbors.

    A tip of solid is thereby drawn back into the solid and a tip of void into the void, so that nothing overlaps.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        A closed manifold.
    low, high : (3,) float64
        Corners of a box: coordinates that lie in one of its faces stay.

    Returns
    -------
    (n, 3) float64
    """
    moved = vertices.copy()
    for _ in range(8):
        kissing = kissing_vertices(moved)
        if not len(kissing):
            break
        concerned = np.zeros(len(vertices), np.bool_)
        concerned[kissing] = True
        near = faces[concerned[faces].any(axis=1)]
        total, count = np.zeros_like(vertices), np.zeros(len(vertices))
        for corner in range(3):
            for other in (1, 2):
                np.add.at(total, near[:, corner], moved[near[:, (corner + other) % 3]])
                np.add.at(count, near[:, corner], 1)
        step = STEP * (total[kissing] / count[kissing, None] - moved[kissing])
        step[(moved[kissing] == low) | (moved[kissing] == high)] = 0.0
        moved[kissing] += step
    return moved
