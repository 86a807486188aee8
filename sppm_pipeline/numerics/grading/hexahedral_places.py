"""Trilinear hexahedra: from places within them to points in space, and back by Newton steps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.meshcheck.box_tree import DEPTH, BoxTree, box_tree

STEPS = 40
"""Newton steps at most; some five do, more where a hexahedron is nearly flat at a corner."""

_NEAR = 1e-9
"""Points on a face of two hexahedra belong to one of them; rounding may not put them into neither."""

_DONE, _LONGEST = 1e-13, 0.7
_OUT = 2.0  # a place so far from the middle is no longer on the way to one inside


def points_in(
    corners: NDArray[np.float64], cell: NDArray[np.integer], places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points at places in hexahedra, and the derivative of the mapping.

    Parameters
    ----------
    corners : (m, 2, 2, 2, 3) float64
        Nodes by x, y, z of the hexahedron.
    cell : (n,) int
    places : (n, 3) float64
        From 0 to 1 along each axis; beyond, the mapping is continued.

    Returns
    -------
    points : (n, 3) float64
    derivative : (n, 3, 3) float64
        Column a is that along axis a.
    """
    points, derivative = np.zeros((len(cell), 3)), np.zeros((len(cell), 3, 3))
    for corner in np.ndindex(2, 2, 2):
        own = corners[(cell, *corner)]
        weights = np.where(corner, places, 1 - places)
        points += own * weights.prod(axis=1)[:, None]
        for axis in range(3):
            others = [a for a in range(3) if a != axis]
            slope = 1.0 if corner[axis] else -1.0
            derivative[:, :, axis] += own * (slope * weights[:, others].prod(axis=1))[:, None]
    return points, derivative


def hexahedron_tree(corners: NDArray[np.float64]) -> BoxTree:
    """The tree of the boxes of hexahedra (m, 2, 2, 2, 3)."""
    nodes = corners.reshape(-1, 8, 3)
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    return box_tree(np.stack([low, high, high], axis=1))


def places_in(
    tree: BoxTree, corners: NDArray[np.float64], points: NDArray[np.float64], apart: int | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The hexahedron around each point, and the place in it.

    Where several hold a point, as on a common face, it is the first of them, and Newton steps begin in the middle, so
    that the result depends on the point alone. Points that follow each other should be near each other.

    Parameters
    ----------
    tree : BoxTree
        By `hexahedron_tree`.
    corners : (m, 2, 2, 2, 3) float64
    points : (n, 3) float64
    apart : int, optional
        So many of the first hexahedra do not overlap; the others may, them and each other. All by default.

    Returns
    -------
    cell : (n,) int32
        -1 outside of all.
    places : (n, 3) float64
        0 to 1 along each axis.
    """
    nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3))
    apart = len(nodes) if apart is None else apart
    return _places_in(tree.order, tree.boxes, tree.starts, nodes, np.ascontiguousarray(points, np.float64), apart)


@jit
def _places_in(
    order: NDArray[np.int64],
    boxes: NDArray[np.float64],
    starts: NDArray[np.int64],
    nodes: NDArray[np.float64],
    points: NDArray[np.float64],
    apart: int,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    leaves = starts.size - 1
    waiting = np.empty(2 * DEPTH, np.int64)
    found = np.full(points.shape[0], -1, np.int32)
    places = np.zeros((points.shape[0], 3))
    place = np.empty(3)
    last = -1
    for i in range(points.shape[0]):
        p = points[i]
        # well inside of that of the point before, there can be no other
        if 0 <= last < apart and _in_box(nodes[last], p) and _newton(nodes[last], p, place, 1e-9):
            found[i] = last
            places[i] = place
            continue
        waiting[0], left = 0, 1
        while left > 0:
            left -= 1
            node = waiting[left]
            b = boxes[node]
            outside = False
            for a in range(3):
                slack = _NEAR * (b[a + 3] - b[a])
                outside = outside or p[a] < b[a] - slack or p[a] > b[a + 3] + slack
            if outside:
                continue
            if node < leaves - 1:
                waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
                left += 2
                continue
            leaf = node - leaves + 1
            for k in range(starts[leaf], starts[leaf + 1]):
                e = order[k]
                if (found[i] < 0 or e < found[i]) and _in_box(nodes[e], p) and _newton(nodes[e], p, place, -_NEAR):
                    found[i] = e
                    places[i] = place
        last = found[i]
        for a in range(3):
            places[i, a] = min(max(places[i, a], 0.0), 1.0)
    return found, places


@jit
def _in_box(nodes: NDArray[np.float64], p: NDArray[np.float64]) -> bool:
    """Whether a point lies in the box of eight nodes, to rounding."""
    for a in range(3):
        low, high = nodes[0, a], nodes[0, a]
        for c in range(1, 8):
            low, high = min(low, nodes[c, a]), max(high, nodes[c, a])
        slack = _NEAR * (high - low)
        if p[a] < low - slack or p[a] > high + slack:
            return False
    return True


@jit
def _newton(nodes: NDArray[np.float64], p: NDArray[np.float64], place: NDArray[np.float64], inside: float) -> bool:
    """Find the place of a point in a hexahedron; whether it lies at least `inside` from all faces, in its edges."""
    x, y, z, longest = 0.5, 0.5, 0.5, 0.0
    r, d = np.empty(3), np.empty((3, 3))
    for _ in range(STEPS):
        # along x, then y, then z
        for a in range(3):
            n000, n001, n010, n011 = nodes[0, a], nodes[1, a], nodes[2, a], nodes[3, a]
            n100, n101, n110, n111 = nodes[4, a], nodes[5, a], nodes[6, a], nodes[7, a]
            x00, x01 = n000 + x * (n100 - n000), n001 + x * (n101 - n001)
            x10, x11 = n010 + x * (n110 - n010), n011 + x * (n111 - n011)
            low, high = x00 + y * (x10 - x00), x01 + y * (x11 - x01)
            r[a] = p[a] - (low + z * (high - low))
            d[a, 2] = high - low
            d[a, 1] = (1 - z) * (x10 - x00) + z * (x11 - x01)
            d[a, 0] = (1 - y) * ((1 - z) * (n100 - n000) + z * (n101 - n001)) + y * (
                (1 - z) * (n110 - n010) + z * (n111 - n011)
            )
        ux = d[1, 1] * d[2, 2] - d[1, 2] * d[2, 1]
        uy = d[1, 2] * d[2, 0] - d[1, 0] * d[2, 2]
        uz = d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]
        det = d[0, 0] * ux + d[0, 1] * uy + d[0, 2] * uz
        if det == 0.0:
            return False
        vx, vy, vz = r[1], r[2], r[0]
        dx = (vz * ux + d[0, 1] * (d[1, 2] * vy - vx * d[2, 2]) + d[0, 2] * (vx * d[2, 1] - d[1, 1] * vy)) / det
        dy = (d[0, 0] * (vx * d[2, 2] - d[1, 2] * vy) + vz * uy + d[0, 2] * (d[1, 0] * vy - vx * d[2, 0])) / det
        dz = (d[0, 0] * (d[1, 1] * vy - vx * d[2, 1]) + d[0, 1] * (vx * d[2, 0] - d[1, 0] * vy) + vz * uz) / det
        longest = max(abs(dx), abs(dy), abs(dz))
        if longest > _LONGEST:
            dx, dy, dz = dx * _LONGEST / longest, dy * _LONGEST / longest, dz * _LONGEST / longest
        x, y, z = x + dx, y + dy, z + dz
        if max(abs(x - 0.5), abs(y - 0.5), abs(z - 0.5)) > _OUT:
            return False
        if longest < _DONE:
            break
    if longest > 1e-7:  # a point that no steps lead to lies beyond
        return False
    place[0], place[1], place[2] = x, y, z
    return min(x, y, z) >= inside and max(x, y, z) <= 1 - inside


@jit
def point_and_volume(
    nodes: NDArray[np.float64], x: float, y: float, z: float, p: NDArray[np.float64], d: NDArray[np.float64]
) -> float:
    """Put the point at a place in a hexahedron (8, 3) into `p`, the derivative into `d`, and return its
    determinant.
    """
    for a in range(3):
        x00, x01 = nodes[0, a] + x * (nodes[4, a] - nodes[0, a]), nodes[1, a] + x * (nodes[5, a] - nodes[1, a])
        x10, x11 = nodes[2, a] + x * (nodes[6, a] - nodes[2, a]), nodes[3, a] + x * (nodes[7, a] - nodes[3, a])
        low, high = x00 + y * (x10 - x00), x01 + y * (x11 - x01)
        p[a] = low + z * (high - low)
        d[2, a] = high - low
        d[1, a] = (1 - z) * (x10 - x00) + z * (x11 - x01)
        d[0, a] = (1 - y) * ((1 - z) * (nodes[4, a] - nodes[0, a]) + z * (nodes[5, a] - nodes[1, a])) + y * (
            (1 - z) * (nodes[6, a] - nodes[2, a]) + z * (nodes[7, a] - nodes[3, a])
        )
    return float(
        d[0, 0] * (d[1, 1] * d[2, 2] - d[1, 2] * d[2, 1])
        - d[0, 1] * (d[1, 0] * d[2, 2] - d[1, 2] * d[2, 0])
        + d[0, 2] * (d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0])
    )


def points_and_volumes(
    corners: NDArray[np.float64], cell: NDArray[np.integer], places: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """As `points_in`, but with the size of the determinant, (n,), in place of the derivative."""
    points, volumes = np.empty((len(cell), 3)), np.empty(len(cell))
    nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3))
    _points_and_volumes(nodes, cell.astype(np.int64), np.ascontiguousarray(places), points, volumes)
    return points, volumes


@jit
def _points_and_volumes(
    nodes: NDArray[np.float64],
    cell: NDArray[np.int64],
    places: NDArray[np.float64],
    points: NDArray[np.float64],
    volumes: NDArray[np.float64],
) -> None:
    d = np.empty((3, 3))
    for n in range(len(cell)):
        volumes[n] = abs(point_and_volume(nodes[cell[n]], places[n, 0], places[n, 1], places[n, 2], points[n], d))
