"""Measures of tetrahedra."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Nodes = NDArray[np.float64]
Cells = NDArray[np.int32]

_SIDES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""The triangle opposite to each corner, its normal pointing outwards."""


def cell_volumes(nodes: Nodes, cells: Cells) -> NDArray[np.float64]:
    """Signed volume of each tetrahedron, (m,); positive if the fourth corner lies where the others' normal points."""
    a, b, c, d = (nodes[cells[:, corner]] for corner in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6)


def _side_normals(nodes: Nodes, cells: Cells) -> NDArray[np.float64]:
    """Outward normal of each side, as long as twice its area, (m, 4, 3)."""
    corners = nodes[cells][:, _SIDES]
    return np.asarray(np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]))


def dihedral_angles(nodes: Nodes, cells: Cells) -> NDArray[np.float64]:
    """Angles between the sides of each tetrahedron, (m, 6), degrees; 70.5 in a regular one."""
    normals = _side_normals(nodes, cells)
    first, second = np.triu_indices(4, 1)
    a, b = normals[:, first], normals[:, second]
    # both the sine and the cosine, as angles near 0 and 180 degrees are the ones that matter
    sine = np.linalg.norm(np.cross(a, b), axis=-1)
    return np.asarray(180 - np.degrees(np.arctan2(sine, np.einsum("ijk,ijk->ij", a, b))))


def aspect_ratios(nodes: Nodes, cells: Cells) -> NDArray[np.float64]:
    """Longest edge over the radius of the inscribed ball, divided by its value 2 sqrt(6) in a regular one, (m,)."""
    corners = nodes[cells]
    first, second = np.triu_indices(4, 1)
    longest = np.linalg.norm(corners[:, first] - corners[:, second], axis=-1).max(1)
    surface = np.linalg.norm(_side_normals(nodes, cells), axis=-1).sum(1) / 2
    radius = 3 * np.abs(cell_volumes(nodes, cells)) / surface
    with np.errstate(divide="ignore"):
        return np.asarray(longest / (2 * 6**0.5 * radius))


def non_manifold_faces(cells: Cells) -> int:
    """Number of triangles that more than two tetrahedra share; none, unless some overlap."""
    sides = np.sort(cells[:, _SIDES].reshape(-1, 3), axis=1)
    sides = sides[np.lexsort(sides.T)]
    starts = np.flatnonzero(np.append(True, (sides[1:] != sides[:-1]).any(1)))
    return int((np.diff(starts, append=len(sides)) > 2).sum())
