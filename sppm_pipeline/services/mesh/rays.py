"""Rays through triangles: exact winding numbers by rays along x, where a ray leaves the solid, and wall thickness."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree
from sppm_pipeline.services.mesh.predicates import side_of_line, side_of_plane

SAMPLES = 100_000
"""Points of the surface from which the thickness is taken."""


def layers_around(tree: BoxTree, labels: I32, points: F64, own: I32) -> I64:
    """Winding numbers of points (k, 3) on a mesh, each without the piece of the mesh that it lies on (-1 for none).

    The crossings of a ray along x are counted with their sign by exact predicates; so for closed pieces the result is
    their winding number, and rays through edges and corners need no care. `labels` (m,) is the piece of each triangle.
    """
    places = np.ascontiguousarray(labels[tree.order], np.int32)
    return _layers(tree.triangles, tree.boxes, tree.starts, places, np.ascontiguousarray(points, np.float64), own)


def exits_along(tree: BoxTree, origins: F64, directions: F64, own: I64, both: bool) -> F64:
    """Distance along rays (k, 3), with directions of length 1, to the first triangle; infinity if none is hit.

    `own` is the triangle of the mesh that each ray starts on, which it does not hit. Unless `both`, triangles count
    only where the ray leaves the solid.
    """
    place = np.empty(len(tree.order), np.int64)
    place[tree.order] = np.arange(len(tree.order))
    return _exits(
        tree.triangles,
        tree.boxes,
        tree.starts,
        np.ascontiguousarray(origins, np.float64),
        np.ascontiguousarray(directions, np.float64),
        place[own],
        both,
    )


class WallThickness(NamedTuple):
    """The result of `wall_thickness`."""

    thickness: F64  # at points that stand for equal areas; infinity where a ray leaves nowhere
    points: F64

    def quantile(self, share: float) -> float:
        """The thickness that this fraction of the area is below."""
        return float(np.quantile(self.thickness, share, method="lower"))

    def share_below(self, limit: float) -> float:
        """The fraction of the area where the wall is thinner than a limit."""
        return float(np.mean(self.thickness < limit))


def wall_thickness(tree: BoxTree, samples: int = SAMPLES) -> WallThickness:
    """Thickness of the walls of a mesh wound outwards.

    Rays run along the inward normal from points spread evenly over the area, the same for the same mesh. Each ends
    where it first leaves the solid through another triangle. Where surfaces meet in a sharp edge the thickness goes to
    0, as it does in the solid; only the fraction of such area says how much of the solid that concerns.
    """
    points, inwards, place = spread_points(tree.triangles, samples)
    return WallThickness(exits_along(tree, points, inwards, tree.order[place], False), points)


def spread_points(triangles: F64, samples: int) -> tuple[F64, F64, I64]:
    """Points spread evenly over the area of triangles (m, 3, 3), the same for the same triangles.

    The points and their unit normals into the solid, (samples, 3), and the triangle that each lies on; none without
    area.
    """
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    share = np.cumsum(twice)
    if not (len(share) and share[-1] > 0):
        return np.empty((0, 3)), np.empty((0, 3)), np.empty(0, np.int64)
    i = np.arange(samples)
    # inside of a triangle, points follow a sequence of low discrepancy (Roberts 2018) that no lattice can resonate with
    place = np.minimum(np.searchsorted(share, (i + 0.5) / samples * share[-1], side="right"), len(share) - 1)
    # 1 / p and 1 / p^2, where p = 1.3247... solves p^3 = p + 1 (the plastic number)
    one, other = (0.5 + i * 0.7548776662466927) % 1, (0.5 + i * 0.5698402909980532) % 1
    # the far half of the parallelogram is folded onto the triangle
    over = one + other > 1
    one, other = np.where(over, 1 - one, one)[:, None], np.where(over, 1 - other, other)[:, None]
    a, b, c = triangles[place, 0], triangles[place, 1], triangles[place, 2]
    return a + one * (b - a) + other * (c - a), -normals[place] / twice[place, None], place


@jit
def _layers(triangles: F64, boxes: F64, starts: I64, labels: I32, points: F64, own: I32) -> I64:
    leaves = starts.size - 1
    waiting = np.empty(DEPTH, np.int64)
    layers = np.zeros(points.shape[0], np.int64)
    for n in range(points.shape[0]):
        p = points[n]
        waiting[0] = 0
        left = 1
        while left > 0:
            left -= 1
            node = waiting[left]
            box = boxes[node]
            if p[0] > box[3] or p[1] < box[1] or p[1] > box[4] or p[2] < box[2] or p[2] > box[5]:
                continue
            if node < leaves - 1:
                waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
                left += 2
                continue
            leaf = node - leaves + 1
            for i in range(starts[leaf], starts[leaf + 1]):
                if labels[i] == own[n]:
                    continue
                t = triangles[i]
                turn = 0
                for e in range(3):
                    a, b = t[e], t[(e + 1) % 3]
                    if (a[2] <= p[2]) == (b[2] <= p[2]):
                        continue
                    # always from the lower end to the upper, so that both triangles at an edge agree
                    if a[2] <= p[2]:
                        turn += side_of_line(a[1], a[2], b[1], b[2], p[1], p[2]) > 0
                    else:
                        turn -= side_of_line(b[1], b[2], a[1], a[2], p[1], p[2]) > 0
                # a triangle turns left seen along -x where its normal points to +x: the ray leaves there
                if turn != 0 and side_of_plane(t[0], t[1], t[2], p) * turn > 0:
                    layers[n] += turn
    return layers


@jit
def _hit(t: F64, p: F64, d: F64, both: bool) -> float:
    """Distance along a ray to a triangle (Möller and Trumbore 1997); infinity if it is not hit."""
    ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
    vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
    hx, hy, hz = d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx
    det = ux * hx + uy * hy + uz * hz  # negative where the ray leaves
    if det == 0.0 or (det > 0.0 and not both):
        return np.inf
    sx, sy, sz = p[0] - t[0, 0], p[1] - t[0, 1], p[2] - t[0, 2]
    one = (sx * hx + sy * hy + sz * hz) / det
    if one < 0.0 or one > 1.0:
        return np.inf
    qx, qy, qz = sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux
    other = (d[0] * qx + d[1] * qy + d[2] * qz) / det
    if other < 0.0 or one + other > 1.0:
        return np.inf
    far = (vx * qx + vy * qy + vz * qz) / det
    return far if far >= 0.0 else np.inf


@jit
def _enters(box: F64, p: F64, d: F64, best: float) -> bool:
    """True if a ray meets a box nearer than the best hit."""
    near, far = 0.0, best
    for a in range(3):
        if d[a] == 0.0:
            if p[a] < box[a] or p[a] > box[a + 3]:
                return False
            continue
        one, other = (box[a] - p[a]) / d[a], (box[a + 3] - p[a]) / d[a]
        # a few roundings wider than the box, lest a flat one be missed
        near, far = max(near, min(one, other) * (1 - 1e-15)), min(far, max(one, other) * (1 + 1e-15))
    return near <= far


@jit
def _exits(triangles: F64, boxes: F64, starts: I64, origins: F64, directions: F64, own: I64, both: bool) -> F64:
    leaves = starts.size - 1
    waiting = np.empty(DEPTH, np.int64)
    far = np.full(origins.shape[0], np.inf)
    for n in range(origins.shape[0]):
        p, d = origins[n], directions[n]
        best = np.inf
        waiting[0] = 0
        left = 1
        while left > 0:
            left -= 1
            node = waiting[left]
            if not _enters(boxes[node], p, d, best):
                continue
            if node < leaves - 1:
                one, other = 2 * node + 1, 2 * node + 2
                # the child whose middle the ray comes to first is looked at first
                ahead = 0.0
                for a in range(3):
                    ahead += d[a] * (boxes[other, a] + boxes[other, a + 3] - boxes[one, a] - boxes[one, a + 3])
                if ahead < 0.0:
                    one, other = other, one
                waiting[left], waiting[left + 1] = other, one
                left += 2
                continue
            leaf = node - leaves + 1
            for i in range(starts[leaf], starts[leaf + 1]):
                if i != own[n]:
                    best = min(best, _hit(triangles[i], p, d, both))
        far[n] = best
    return far
