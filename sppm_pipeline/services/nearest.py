"""Nearest triangles of a surface, and elements of a mesh around or nearest to points, by a tree of boxes."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree, box_tree


@jit
def squared_to_triangle(t: F64, x: float, y: float, z: float) -> float:
    """Squared distance of a point from triangle (3, 3): the foot lies inside, on an edge or at a corner."""
    ax, ay, az = t[0, 0], t[0, 1], t[0, 2]
    ux, uy, uz = t[1, 0] - ax, t[1, 1] - ay, t[1, 2] - az
    vx, vy, vz = t[2, 0] - ax, t[2, 1] - ay, t[2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    uu, uv, vv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz, vx * vx + vy * vy + vz * vz
    pu, pv = px * ux + py * uy + pz * uz, px * vx + py * vy + pz * vz
    det = uu * vv - uv * uv
    s, r = vv * pu - uv * pv, uu * pv - uv * pu
    if det > 0.0 and s >= 0.0 and r >= 0.0 and s + r <= det:
        s, r = s / det, r / det
        dx, dy, dz = px - s * ux - r * vx, py - s * uy - r * vy, pz - s * uz - r * vz
        return float(dx * dx + dy * dy + dz * dz)
    best = np.inf
    for e in range(3):
        b = (e + 1) % 3
        ex, ey, ez = t[b, 0] - t[e, 0], t[b, 1] - t[e, 1], t[b, 2] - t[e, 2]
        qx, qy, qz = x - t[e, 0], y - t[e, 1], z - t[e, 2]
        length = ex * ex + ey * ey + ez * ez
        share = 0.0
        if length > 0.0:
            share = min(1.0, max(0.0, (qx * ex + qy * ey + qz * ez) / length))
        dx, dy, dz = qx - share * ex, qy - share * ey, qz - share * ez
        best = min(best, dx * dx + dy * dy + dz * dz)
    return best


def surface_distances(tree: BoxTree, points: F64) -> F64:
    """Exact distance of points (n, 3) from the nearest triangle of a surface, (n,), without a sign."""
    return _distances(tree.triangles, tree.boxes, tree.starts, np.ascontiguousarray(points, np.float64))


def element_tree(corners: F64) -> BoxTree:
    """The tree of the boxes of tetrahedra (m, 4, 3); its triangles are the low and high corners of these boxes."""
    low, high = corners.min(axis=1), corners.max(axis=1)
    return box_tree(np.stack([low, high, high], axis=1))


def locate(tree: BoxTree, corners: F64, points: F64) -> tuple[I64, F64]:
    """The tetrahedron (n,) around each point, -1 for none, and the weights of its corners (n, 4), barycentric, 0 to 1.

    The tree is that of `element_tree`. Where several hold a point, as on a common face, it is the first of them in the
    mesh, so that the result does not depend on which points are asked for.
    """
    return _locate(tree.order, tree.boxes, tree.starts, corners, np.ascontiguousarray(points, np.float64))


def nearest_in(corners: F64, tetrahedra: I64, node: I64, points: F64) -> tuple[I64, F64]:
    """For points outside of a mesh a tetrahedron (n,) at the nearest node, and weights (n, 4) of a place in it.

    It is the node, or a place in one of the tetrahedra around it where weights that would be negative are zero,
    whichever is nearer to the point.
    """
    order = np.argsort(tetrahedra.ravel(), kind="stable")
    count = int(max(tetrahedra.max(), node.max(initial=0))) + 1
    first = np.concatenate([[0], np.cumsum(np.bincount(tetrahedra.ravel(), minlength=count))])
    return _least_outside(corners, first, order // 4, node, np.ascontiguousarray(points, np.float64))


@jit
def _least_outside(corners: F64, first: I64, around: I64, node: I64, points: F64) -> tuple[I64, F64]:
    found = np.full(points.shape[0], -1, np.int64)
    weights = np.zeros((points.shape[0], 4))
    own = np.empty(4)
    for i in range(points.shape[0]):
        best = np.inf
        for k in range(first[node[i]], first[node[i] + 1]):
            t, p = corners[around[k]], points[i]
            _barycentric(t, p, own)
            for way in range(2):
                if way == 0:  # the node; it is one of the corners
                    nearest = 0
                    for c in range(1, 4):
                        if _squared(t, p, c) < _squared(t, p, nearest):
                            nearest = c
                    place = np.zeros(4)
                    place[nearest] = 1.0
                else:
                    place = np.maximum(own, 0.0)
                    place /= place.sum()
                squared = 0.0
                for a in range(3):
                    away = place[0] * t[0, a] + place[1] * t[1, a] + place[2] * t[2, a] + place[3] * t[3, a] - p[a]
                    squared += away * away
                if squared < best:
                    best = squared
                    found[i] = around[k]
                    weights[i] = place
    return found, weights


@jit
def _squared(t: F64, p: F64, corner: int) -> float:
    x, y, z = t[corner, 0] - p[0], t[corner, 1] - p[1], t[corner, 2] - p[2]
    return float(x * x + y * y + z * z)


@jit
def _squared_to_box(box: F64, point: F64) -> float:
    squared = 0.0
    for a in range(3):
        away = max(box[a] - point[a], point[a] - box[a + 3], 0.0)
        squared += away * away
    return squared


@jit
def _distances(triangles: F64, boxes: F64, starts: I64, points: F64) -> F64:
    leaves = starts.size - 1
    waiting = np.empty(2 * DEPTH, np.int64)
    distances = np.empty(points.shape[0])
    last = 0  # the nearest triangle of one point bounds the distance of the next one, which is often near it
    for i in range(points.shape[0]):
        best = squared_to_triangle(triangles[last], points[i, 0], points[i, 1], points[i, 2])
        waiting[0], left = 0, 1
        while left > 0:
            left -= 1
            node = waiting[left]
            if _squared_to_box(boxes[node], points[i]) >= best:
                continue
            if node < leaves - 1:
                near, far = 2 * node + 1, 2 * node + 2
                if _squared_to_box(boxes[far], points[i]) < _squared_to_box(boxes[near], points[i]):
                    near, far = far, near
                waiting[left], waiting[left + 1] = far, near
                left += 2
            else:
                leaf = node - leaves + 1
                for k in range(starts[leaf], starts[leaf + 1]):
                    squared = squared_to_triangle(triangles[k], points[i, 0], points[i, 1], points[i, 2])
                    if squared < best:
                        best, last = squared, k
        distances[i] = np.sqrt(best)
    return distances


# Points on a face of two elements belong to one of them; rounding may not put them into neither.
_OUTSIDE = -1e-9


@jit
def _locate(order: I64, boxes: F64, starts: I64, corners: F64, points: F64) -> tuple[I64, F64]:
    leaves = starts.size - 1
    waiting = np.empty(2 * DEPTH, np.int64)
    found = np.full(points.shape[0], -1, np.int64)
    weights = np.zeros((points.shape[0], 4))
    own = np.empty(4)
    for i in range(points.shape[0]):
        p = points[i]
        waiting[0], left = 0, 1
        while left > 0:
            left -= 1
            node = waiting[left]
            if _squared_to_box(boxes[node], p) > 0.0:
                continue
            if node < leaves - 1:
                waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
                left += 2
                continue
            leaf = node - leaves + 1
            for k in range(starts[leaf], starts[leaf + 1]):
                e = order[k]
                if found[i] >= 0 and e > found[i]:
                    continue
                _barycentric(corners[e], p, own)
                if own.min() >= _OUTSIDE:
                    found[i] = e
                    weights[i] = own
    return found, weights


@jit
def _barycentric(t: F64, p: F64, out: F64) -> None:
    """Weights of the corners of tetrahedron (4, 3) at a point (Cramer); minus infinity for a flat one."""
    ax, ay, az = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    bx, by, bz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    cx, cy, cz = t[3, 0] - t[0, 0], t[3, 1] - t[0, 1], t[3, 2] - t[0, 2]
    px, py, pz = p[0] - t[0, 0], p[1] - t[0, 1], p[2] - t[0, 2]
    ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    det = ax * ux + ay * uy + az * uz
    if det == 0.0:
        out[:] = -np.inf
        return
    vx, vy, vz = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
    out[1] = (px * ux + py * uy + pz * uz) / det
    out[2] = -(vx * cx + vy * cy + vz * cz) / det
    out[3] = (vx * bx + vy * by + vz * bz) / det
    out[0] = 1.0 - out[1] - out[2] - out[3]
