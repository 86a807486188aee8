"""Rays through triangles: how often a ray along x leaves a mesh, exactly, and where a ray first leaves the solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.meshcheck.box_tree import DEPTH, BoxTree
from sppm_pipeline.numerics.meshcheck.exact_side import side_of_line, side_of_plane


def layers_around(
    tree: BoxTree, labels: NDArray[np.int32], points: NDArray[np.float64], own: NDArray[np.int32]
) -> NDArray[np.int64]:
    """How often the rest of a mesh goes around points, each on a piece of the mesh that does not count.

    The crossings of a ray along x are counted with their sign by exact predicates; so for closed pieces the result is
    their winding number, and rays through edges and corners need no care.

    Parameters
    ----------
    tree : BoxTree
    labels : (m,) int32
        The piece of each triangle of the mesh, numbered from 0.
    points : (k, 3) float64
    own : (k,) int32
        The piece that each point lies on; -1 for none.

    Returns
    -------
    (k,) int64
    """
    places = np.ascontiguousarray(labels[tree.order], np.int32)
    return _layers(tree.triangles, tree.boxes, tree.starts, places, np.ascontiguousarray(points, np.float64), own)


def exits_along(
    tree: BoxTree, origins: NDArray[np.float64], directions: NDArray[np.float64], own: NDArray[np.int64], both: bool
) -> NDArray[np.float64]:
    """How far it is along rays to a triangle.

    Parameters
    ----------
    tree : BoxTree
    origins, directions : (k, 3) float64
        Directions of length 1.
    own : (k,) int64
        The triangle of the mesh that each ray starts on, which it does not hit.
    both : bool
        Whether triangles count that the ray meets from outside, too, or only those where it leaves the solid.

    Returns
    -------
    (k,) float64
        Infinity where nothing is hit.
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


@jit
def _layers(
    triangles: NDArray[np.float64],
    boxes: NDArray[np.float64],
    starts: NDArray[np.int64],
    labels: NDArray[np.int32],
    points: NDArray[np.float64],
    own: NDArray[np.int32],
) -> NDArray[np.int64]:
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
def _hit(t: NDArray[np.float64], p: NDArray[np.float64], d: NDArray[np.float64], both: bool) -> float:
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
def _enters(box: NDArray[np.float64], p: NDArray[np.float64], d: NDArray[np.float64], best: float) -> bool:
    """Whether a ray meets a box nearer than the best hit."""
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
def _exits(
    triangles: NDArray[np.float64],
    boxes: NDArray[np.float64],
    starts: NDArray[np.int64],
    origins: NDArray[np.float64],
    directions: NDArray[np.float64],
    own: NDArray[np.int64],
    both: bool,
) -> NDArray[np.float64]:
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
