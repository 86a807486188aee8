"""Periodicity across opposite faces whose meshes do not match: mortar (L2) projection, or collocation."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.numerics import F64, I32, I64, jit

# Dunavant's quadrature of degree 4 on the triangle (Int. J. Numer. Meth. Eng. 21, 1985):
# the product of two quadratic functions is integrated exactly
_W1, _A1, _W2, _A2 = 0.223381589678011, 0.445948490915965, 0.109951743655322, 0.091576213509771
_QUADRATURE = np.array(
    [[_W1, _A1, _A1], [_W1, 1 - 2 * _A1, _A1], [_W1, _A1, 1 - 2 * _A1],
     [_W2, _A2, _A2], [_W2, 1 - 2 * _A2, _A2], [_W2, _A2, 1 - 2 * _A2]]
)  # fmt: skip

# corners of the sides of a tetrahedron, and the mid-edge nodes on the edges 01, 12, 20 of each
_SIDES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
_MIDS = np.array([[5, 9, 8], [7, 9, 6], [4, 8, 7], [6, 5, 4]])

_SLIVER = 1e-12
"""Overlaps smaller than this fraction of a triangle are rounding."""


class FacePair(NamedTuple):
    """The triangles of a mesh on two opposite faces of its box."""

    axis: int
    low: I64  # (a, 3 or 6), nodes of the triangles, corners first, mid-edge nodes on 01, 12, 20
    high: I64  # the same


def face_pairs(nodes: F64, cells: I32, box: F64, tolerance: float) -> list[FacePair]:
    """Boundary triangles on the faces of the box, (2, 3), within `tolerance` (in the unit of the nodes)."""
    corners = np.concatenate([cells[:, side] for side in _SIDES]).astype(np.int64)
    mids = (
        np.concatenate([cells[:, side] for side in _MIDS]).astype(np.int64) if cells.shape[1] == 10 else corners[:, :0]
    )
    order = np.sort(corners, axis=1)
    _, first, count = np.unique(order, axis=0, return_index=True, return_counts=True)
    single = np.sort(first[count == 1])
    triangles = np.concatenate([corners, mids], axis=1)[single]
    pairs = []
    for axis in range(3):
        place = nodes[triangles[:, :3], axis]
        low, high = (triangles[(np.abs(place - wall) <= tolerance).all(axis=1)] for wall in box[:, axis])
        pairs.append(FacePair(axis, low, high))
    return pairs


def mortar(nodes: F64, pair: FacePair) -> Any:
    """Constraints ``integral of phi (u_high - u_low) = 0`` for every shape function phi of the high face, csr (c, n).

    Both sides are integrated over the overlap of the two triangulations, exactly. One row for each node of the high
    face that overlaps the low one. Bernardi, Maday and Patera 1994; for periodic cells Reis and Andrade Pires 2014, "A
    mortar based approach for the enforcement of periodic boundary conditions on arbitrarily generated meshes".
    """
    from scipy.sparse import coo_matrix

    rows, columns, values = [], [], []
    low, high = (_in_plane(nodes, triangles, pair.axis) for triangles in (pair.low, pair.high))
    pairs = _candidates(low, high)
    if len(pairs):
        width = pair.low.shape[1]
        own, other, area = _overlaps(low, high, pairs, width, _QUADRATURE)
        used = area > 0
        for block, sign, triangles, which in ((own, 1.0, pair.high, 1), (other, -1.0, pair.low, 0)):
            rows.append(np.repeat(pair.high[pairs[used, 1]], width, axis=1).reshape(-1))
            columns.append(np.tile(triangles[pairs[used, which]], (1, width)).reshape(-1))
            values.append(sign * block[used].reshape(-1))
    size = len(nodes)
    if not rows:
        return coo_matrix((0, size)).tocsr()
    return _nonzero_rows(rows, columns, values, size)


def collocation(nodes: F64, pair: FacePair) -> Any:
    """Constraints ``u_high(node) = u_low(there)`` for the nodes of the high face.

    Makes cells 0.4 to 0.6 % softer than the mortar where meshes are coarse; kept for comparison. A node that lies
    beside every triangle of the low face takes the nearest one within a tenth of its size, else it stays free.
    """
    from scipy.sparse import coo_matrix

    wanted = np.unique(pair.high)
    axes = [a for a in range(3) if a != pair.axis]
    low = _in_plane(nodes, pair.low, pair.axis)
    chosen, shares = _located(np.ascontiguousarray(nodes[wanted][:, axes]), low)
    found = chosen >= 0
    shapes = _shapes_at(shares[found], pair.low.shape[1])
    width = pair.low.shape[1]
    rows = np.concatenate([wanted[found], np.repeat(wanted[found], width)])
    columns = np.concatenate([wanted[found], pair.low[chosen[found]].reshape(-1)])
    values = np.concatenate([np.ones(int(found.sum())), -shapes.reshape(-1)])
    if not len(rows):
        return coo_matrix((0, len(nodes))).tocsr()
    return _nonzero_rows([rows], [columns], [values], len(nodes))


def _nonzero_rows(rows: list[Any], columns: list[Any], values: list[Any], size: int) -> Any:
    from scipy.sparse import coo_matrix

    full = coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    ).tocsr()
    weight = np.sqrt(np.asarray(full.multiply(full).sum(axis=1)).ravel())
    kept = np.flatnonzero(weight > 1e-9 * weight.max())
    scaled = full[kept]
    # rows of one length, so that those of small triangles count as much
    scaled.data /= np.repeat(weight[kept], np.diff(scaled.indptr))
    return scaled


def _in_plane(nodes: F64, triangles: I64, axis: int) -> F64:
    """Corners in the two other coordinates, (a, 3, 2)."""
    axes = [a for a in range(3) if a != axis]
    return np.ascontiguousarray(nodes[triangles[:, :3]][:, :, axes])


def _candidates(low: F64, high: F64) -> I64:
    """Pairs (of low, of high) whose boxes overlap, in a fixed order, (p, 2)."""
    if not len(low) or not len(high):
        return np.empty((0, 2), np.int64)
    from scipy.spatial import cKDTree

    middles, reach = [], []
    for corners in (low, high):
        middles.append((corners.min(axis=1) + corners.max(axis=1)) / 2)
        reach.append(float((corners.max(axis=1) - corners.min(axis=1)).max()) / 2)
    tree = cKDTree(middles[0])
    near = tree.query_ball_point(middles[1], sum(reach), p=np.inf, return_sorted=True)
    firsts = np.concatenate([np.asarray(found, np.int64) for found in near])
    seconds = np.repeat(np.arange(len(high), dtype=np.int64), [len(found) for found in near])
    a, b = low[firsts], high[seconds]
    meet = ((a.min(axis=1) <= b.max(axis=1)) & (b.min(axis=1) <= a.max(axis=1))).all(axis=1)
    return np.stack([firsts[meet], seconds[meet]], axis=1)


def _shapes_at(shares: F64, width: int) -> F64:
    """Shape functions of triangles at barycentric coordinates (n, 3): (n, width)."""
    if width == 3:
        return shares
    a, b, c = shares.T
    return np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1)


@jit
def _barycentric(corners: F64, x: float, y: float, out: F64) -> None:
    """Barycentric coordinates of a point."""
    ux, uy = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1]
    vx, vy = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1]
    px, py = x - corners[0, 0], y - corners[0, 1]
    det = ux * vy - uy * vx
    out[1] = (px * vy - py * vx) / det
    out[2] = (ux * py - uy * px) / det
    out[0] = 1.0 - out[1] - out[2]


@jit
def _located(points: F64, low: F64) -> tuple[I64, F64]:
    """For each point the triangle that it lies deepest in, -1 if it is far from all, and its coordinates in it."""
    chosen = np.full(len(points), -1)
    shares = np.zeros((len(points), 3))
    trial = np.empty(3)
    for p in range(len(points)):
        # the smallest barycentric coordinate is positive inside; down to this a point still belongs to a triangle
        best = -0.1
        for t in range(len(low)):
            _barycentric(low[t], points[p, 0], points[p, 1], trial)
            depth = min(trial[0], min(trial[1], trial[2]))
            if depth > best:
                best = depth
                chosen[p] = t
                for i in range(3):
                    shares[p, i] = trial[i]
    return chosen, shares


@jit
def _shape(shares: F64, width: int, out: F64) -> None:
    a, b, c = shares[0], shares[1], shares[2]
    if width == 3:
        out[0], out[1], out[2] = a, b, c
    else:
        out[0], out[1], out[2] = a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1)
        out[3], out[4], out[5] = 4 * a * b, 4 * b * c, 4 * c * a


@jit
def _overlaps(low: F64, high: F64, pairs: I64, width: int, quadrature: F64) -> tuple[F64, F64, F64]:
    """Integrals over the overlap of each pair: high by high, high by low, and the area of the overlap."""
    own = np.zeros((len(pairs), width, width))
    other = np.zeros((len(pairs), width, width))
    areas = np.zeros(len(pairs))
    polygon = np.empty((9, 2))
    clipped = np.empty((9, 2))
    shares_low, shares_high = np.empty(3), np.empty(3)
    shape_low, shape_high = np.empty(6), np.empty(6)
    for p in range(len(pairs)):
        a, b = low[pairs[p, 0]], high[pairs[p, 1]]
        count = 3
        for i in range(3):
            polygon[i, 0], polygon[i, 1] = b[i, 0], b[i, 1]
        turn = (a[1, 0] - a[0, 0]) * (a[2, 1] - a[0, 1]) - (a[1, 1] - a[0, 1]) * (a[2, 0] - a[0, 0])
        sense = 1.0 if turn > 0 else -1.0
        # Sutherland and Hodgman's clipping (1974); a triangle cut by three lines has at most six corners
        for side in range(3):  # the polygon is cut by one side of the other triangle after the other
            x0, y0 = a[side, 0], a[side, 1]
            dx, dy = a[(side + 1) % 3, 0] - x0, a[(side + 1) % 3, 1] - y0
            made = 0
            for i in range(count):
                j = (i + 1) % count
                here = sense * (dx * (polygon[i, 1] - y0) - dy * (polygon[i, 0] - x0))
                there = sense * (dx * (polygon[j, 1] - y0) - dy * (polygon[j, 0] - x0))
                if here >= 0:
                    clipped[made, 0], clipped[made, 1] = polygon[i, 0], polygon[i, 1]
                    made += 1
                if (here > 0 and there < 0) or (here < 0 and there > 0):
                    t = here / (here - there)
                    clipped[made, 0] = polygon[i, 0] + t * (polygon[j, 0] - polygon[i, 0])
                    clipped[made, 1] = polygon[i, 1] + t * (polygon[j, 1] - polygon[i, 1])
                    made += 1
            count = made
            for i in range(count):
                polygon[i, 0], polygon[i, 1] = clipped[i, 0], clipped[i, 1]
            if count < 3:
                break
        if count < 3:
            continue
        for fan in range(1, count - 1):
            ux, uy = polygon[fan, 0] - polygon[0, 0], polygon[fan, 1] - polygon[0, 1]
            vx, vy = polygon[fan + 1, 0] - polygon[0, 0], polygon[fan + 1, 1] - polygon[0, 1]
            area = abs(ux * vy - uy * vx) / 2
            if not area > _SLIVER * abs(turn):
                continue
            areas[p] += area
            for q in range(len(quadrature)):
                x = polygon[0, 0] + quadrature[q, 1] * ux + quadrature[q, 2] * vx
                y = polygon[0, 1] + quadrature[q, 1] * uy + quadrature[q, 2] * vy
                _barycentric(a, x, y, shares_low)
                _barycentric(b, x, y, shares_high)
                _shape(shares_low, width, shape_low)
                _shape(shares_high, width, shape_high)
                for i in range(width):
                    for j in range(width):
                        own[p, i, j] += area * quadrature[q, 0] * shape_high[i] * shape_high[j]
                        other[p, i, j] += area * quadrature[q, 0] * shape_high[i] * shape_low[j]
    return own, other, areas
