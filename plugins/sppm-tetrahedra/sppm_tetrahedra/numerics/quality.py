"""Shape quality of tetrahedra: dihedral angles, aspect ratios, volumes, orientation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import F64, I32, I64, jit

EDGES = np.array([(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)], np.int64)
"""Corners at the ends of the edges, in the order of their nodes."""


def with_mid_nodes(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> tuple[F64, I32]:
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


def minimum_jacobian(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> F64:
    """The smallest Jacobian determinant of each quadratic tetrahedron (m, 10) at its ten nodes, (m,).

    Six times the volume for one with straight edges and nodes in their middles. Positive values at the nodes do not
    prove that it is positive in between, but that is where curved edges fail first.
    """
    corners = np.eye(4)
    points = np.asarray(nodes, np.float64)[tets]
    least = np.full(len(points), np.inf)
    for gradient in quadratic_gradients(np.concatenate([corners, corners[EDGES].mean(1)])):
        np.minimum(least, np.linalg.det(np.einsum("mni,nj->mij", points, gradient)), out=least)
    return least


SLOPES = np.array([(-1.0, -1, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)])
"""Gradients of the barycentric coordinates (1 - r - s - t, r, s, t) by r, s and t."""


def quadratic_gradients(weights: F64) -> F64:
    """Gradients of the shape functions of quadratic tetrahedra at barycentric coordinates (p, 4), (p, 10, 3)."""
    a, b = EDGES.T
    ends = 4 * (weights[:, a, None] * SLOPES[b] + weights[:, b, None] * SLOPES[a])
    return np.concatenate([(4 * weights[..., None] - 1) * SLOPES, ends], axis=1)


_FIFTHS = 900
"""Bins of the histogram, a fifth of a degree each."""


class Quality(NamedTuple):
    """The result of `quality`. Cells without volume have no angles; they are counted as inverted."""

    minimum_dihedral: float  # over all cells and their six edges, degrees
    maximum_dihedral: float  # the same
    radius_ratio: float  # the largest circumradius over three times the inradius; 1 for a regular tetrahedron
    edge_ratio: float  # the largest longest edge over shortest edge of a cell
    volume: float  # sum, with sign
    minimum_volume: float  # of a cell, with sign
    maximum_volume: float  # the same
    inverted: int  # cells without positive volume


def quality(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> Quality:
    """Measure tetrahedra by their corners, (n, 3) and (m, 4 or more); ValueError if there is none."""
    if not len(tets):
        raise ValueError("a mesh without tetrahedra has no quality")
    points, corners = _prepared(nodes, tets)
    worst = _worst(points, corners)
    angles = np.degrees(np.arccos(np.clip(worst[:2], -1, 1)))
    ratio, edges, total, least, greatest = (float(v) for v in worst[2:7])
    return Quality(float(angles[0]), float(angles[1]), ratio, edges, total, least, greatest, int(worst[7]))


def dihedral_histogram(nodes: NDArray[np.floating], tets: NDArray[np.integer], bins: int = 90) -> I64:
    """Number of dihedral angles in each of `bins` (a divisor of 900) equal intervals of 0 to 180 degrees, (bins,)."""
    if bins < 1 or _FIFTHS % bins:
        raise ValueError(f"the number of bins must divide {_FIFTHS}, not be {bins}")
    counts = _count_angles(*_prepared(nodes, tets))
    return np.asarray(counts.reshape(bins, -1).sum(1))


def dihedral_extremes(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> F64:
    """The smallest and the greatest dihedral angle of each tetrahedron, degrees, (m, 2).

    A tetrahedron without positive volume has 0 and 180.
    """
    return np.asarray(np.degrees(np.arccos(np.clip(_cosines(*_prepared(nodes, tets)), -1, 1))))


def volumes(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> F64:
    """Volumes of tetrahedra with straight edges, with sign, (m,)."""
    points, corners = _prepared(nodes, tets)
    a, b, c, d = (points[corners[:, i]] for i in range(4))
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a)) / 6


def _prepared(nodes: NDArray[np.floating], tets: NDArray[np.integer]) -> tuple[F64, I32]:
    points = np.ascontiguousarray(nodes, np.float64)
    corners = np.ascontiguousarray(tets[:, :4], np.int32)
    if corners.size and (corners.min() < 0 or corners.max() >= len(points)):
        raise ValueError("a tetrahedron names a node that does not exist")
    return points, corners


@jit
def _shape(points: F64, corners: I32, m: int, p: F64, normals: F64, out: F64) -> None:
    """Cosines of the six dihedral angles, six times the volume, radius ratio, shortest and longest edge squared."""
    for i in range(4):
        for axis in range(3):
            p[i, axis] = points[corners[m, i], axis]
    for i in range(4):  # the face opposite of corner i
        a, b, c = (i + 1) % 4, (i + 2) % 4, (i + 3) % 4
        if i % 2 == 1:
            b, c = c, b
        for axis in range(3):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            normals[i, axis] = (p[b, u] - p[a, u]) * (p[c, v] - p[a, v]) - (p[b, v] - p[a, v]) * (p[c, u] - p[a, u])
    volume = 0.0
    for axis in range(3):
        volume += normals[0, axis] * (p[1, axis] - p[0, axis])
    n = 0
    shortest, longest = np.inf, 0.0
    area = 0.0
    for i in range(4):
        length_i = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        area += length_i
        for j in range(i + 1, 4):
            length_j = np.sqrt(normals[j, 0] ** 2 + normals[j, 1] ** 2 + normals[j, 2] ** 2)
            dot, edge = 0.0, 0.0
            for axis in range(3):
                dot += normals[i, axis] * normals[j, axis]
                edge += (p[i, axis] - p[j, axis]) ** 2
            out[n] = -dot / (length_i * length_j) if length_i * length_j > 0 else np.nan
            n += 1
            shortest, longest = min(shortest, edge), max(longest, edge)
    # circumradius: products of opposite edges are the sides of a triangle of area 6 V R
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        to_top, opposite = 0.0, 0.0
        for axis in range(3):
            to_top += (p[i, axis] - p[3, axis]) ** 2
            opposite += (p[j, axis] - p[k, axis]) ** 2
        out[7 + i] = np.sqrt(to_top * opposite)
    la, lb, lc = out[7], out[8], out[9]
    s = (la + lb + lc) / 2
    product = max(0.0, s * (s - la) * (s - lb) * (s - lc))
    out[6] = volume
    # R = sqrt(product) / (6 V), r = 3 V / A with 6 V = volume, A = area / 2
    out[7] = np.sqrt(product) / volume * area / (3 * volume) if volume > 0 else np.inf
    out[8], out[9] = shortest, longest


@jit
def _worst(points: F64, corners: I32) -> F64:
    p, normals, out = np.empty((4, 3)), np.empty((4, 3)), np.empty(10)
    worst = np.array([-1.0, 1.0, 0.0, 0.0, 0.0, np.inf, -np.inf, 0.0])
    for m in range(corners.shape[0]):
        _shape(points, corners, m, p, normals, out)
        volume = out[6] / 6.0
        worst[4] += volume
        worst[5], worst[6] = min(worst[5], volume), max(worst[6], volume)
        worst[3] = max(worst[3], np.sqrt(out[9] / out[8]) if out[8] > 0 else np.inf)
        worst[2] = max(worst[2], out[7])
        if not volume > 0:
            worst[7] += 1
            continue
        for i in range(6):
            worst[0], worst[1] = max(worst[0], out[i]), min(worst[1], out[i])
    return worst


@jit
def _cosines(points: F64, corners: I32) -> F64:
    p, normals, out = np.empty((4, 3)), np.empty((4, 3)), np.empty(10)
    found = np.empty((corners.shape[0], 2))
    for m in range(corners.shape[0]):
        _shape(points, corners, m, p, normals, out)
        greatest, least = -1.0, 1.0
        for i in range(6):
            greatest, least = max(greatest, out[i]), min(least, out[i])
        good = out[6] > 0
        found[m, 0] = greatest if good else 1.0
        found[m, 1] = least if good else -1.0
    return found


@jit
def _count_angles(points: F64, corners: I32) -> I64:
    p, normals, out = np.empty((4, 3)), np.empty((4, 3)), np.empty(10)
    counts = np.zeros(_FIFTHS, np.int64)
    for m in range(corners.shape[0]):
        _shape(points, corners, m, p, normals, out)
        if out[6] > 0:
            for i in range(6):
                angle = np.degrees(np.arccos(min(1.0, max(-1.0, out[i]))))
                # an angle of exactly 180 degrees belongs to the last bin
                counts[min(_FIFTHS - 1, int(angle * (_FIFTHS / 180.0)))] += 1
    return counts
