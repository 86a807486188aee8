"""Trilinear hexahedra: from places within them to points in space, and back by Newton steps, or by halving where these
lead nowhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree, box_tree

STEPS = 40
"""Newton steps at most; some five do, more where a hexahedron is nearly flat at a corner."""

_NEAR = 1e-9
"""Points on a face of two hexahedra belong to one of them; rounding may not put them into neither."""

_DONE, _LONGEST = 1e-13, 0.7
_BOXES = 48  # halves that wait: boxes of which so many are nested are smaller than rounding
_OUT = 2.0  # a place so far from the middle is no longer on the way to one inside


def points_in(corners: F64, cell: NDArray[np.integer], places: F64) -> tuple[F64, F64]:
    """Points (n, 3) at places in hexahedra `corners` (m, 2, 2, 2, 3), nodes by x, y, z, and the derivative of the
    mapping (n, 3, 3), whose column a is that along axis a.

    `places` (n, 3) go from 0 to 1 along each axis; beyond, the mapping is continued.
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


def hexahedron_tree(corners: F64) -> BoxTree:
    """The tree of the boxes of hexahedra (m, 2, 2, 2, 3)."""
    nodes = corners.reshape(-1, 8, 3)
    low, high = nodes.min(axis=1), nodes.max(axis=1)
    return box_tree(np.stack([low, high, high], axis=1))


def places_in(tree: BoxTree, corners: F64, points: F64, apart: int | None = None) -> tuple[I32, F64]:
    """The hexahedron (n,) around each point (n, 3), -1 outside of all, and the place in it (n, 3), 0 to 1 along each
    axis.

    Where several hold a point, as on a common face, it is the first of them, and Newton steps begin in the middle, so
    that the result depends on the point alone. Points that follow each other should be near each other. Of the
    hexahedra `corners` (m, 2, 2, 2, 3), with their `hexahedron_tree`, so many of the first as `apart` do not overlap,
    all by default; the others may, them and each other.
    """
    nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3))
    apart = len(nodes) if apart is None else apart
    return _places_in(tree.order, tree.boxes, tree.starts, nodes, np.ascontiguousarray(points, np.float64), apart)


@jit
def _places_in(order: I64, boxes: F64, starts: I64, nodes: F64, points: F64, apart: int) -> tuple[I32, F64]:
    leaves = starts.size - 1
    waiting = np.empty(2 * DEPTH, np.int64)
    found = np.full(points.shape[0], -1, np.int32)
    places = np.zeros((points.shape[0], 3))
    place, missed = np.empty(3), np.empty(nodes.shape[0], np.int64)
    scratch = _Scratch(np.empty((_BOXES, 2, 3)), np.empty((8, 3)), np.empty((2, 3, 3)), np.empty((4, 3)))
    last = -1
    for i in range(points.shape[0]):
        p = points[i]
        # well inside of that of the point before, there can be no other
        if 0 <= last < apart and _in_box(nodes[last], p) and _newton(nodes[last], p, place, 1e-9):
            found[i] = last
            places[i] = place
            continue
        waiting[0], left, misses = 0, 1, 0
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
                if (found[i] < 0 or e < found[i]) and _in_box(nodes[e], p):
                    if _newton(nodes[e], p, place, -_NEAR):
                        found[i] = e
                        places[i] = place
                    elif e < apart:
                        missed[misses] = e
                        misses += 1
        if not 0 <= found[i] < apart:
            # Newton steps from the middle may miss a place, or end at one beyond that maps to the same point
            for e in missed[:misses]:
                if (not 0 <= found[i] < e) and _search(nodes[e], p, scratch, place):
                    found[i] = e
                    places[i] = place
        last = found[i]
        for a in range(3):
            places[i, a] = min(max(places[i, a], 0.0), 1.0)
    return found, places


@jit
def _in_box(nodes: F64, p: F64) -> bool:
    """Test whether a point lies in the box of eight nodes, to rounding."""
    for a in range(3):
        low, high = nodes[0, a], nodes[0, a]
        for c in range(1, 8):
            low, high = min(low, nodes[c, a]), max(high, nodes[c, a])
        slack = _NEAR * (high - low)
        if p[a] < low - slack or p[a] > high + slack:
            return False
    return True


@jit
def _newton(nodes: F64, p: F64, place: F64, inside: float) -> bool:
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
def _beside(nodes: F64, p: F64) -> bool:
    """Test whether a point lies farther out across one of a hexahedron's faces than all of its nodes."""
    for face in range(6):
        # nodes are numbered by bits, and those of a face have one in common
        bit, side = 4 >> face // 2, face % 2
        one, other = (2 if bit == 4 else 4), (2 if bit == 1 else 1)
        n = bit * side
        ux, uy, uz = (
            nodes[n + one + other, 0] - nodes[n, 0],
            nodes[n + one + other, 1] - nodes[n, 1],
            nodes[n + one + other, 2] - nodes[n, 2],
        )
        vx, vy, vz = (
            nodes[n + other, 0] - nodes[n + one, 0],
            nodes[n + other, 1] - nodes[n + one, 1],
            nodes[n + other, 2] - nodes[n + one, 2],
        )
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        at = x * p[0] + y * p[1] + z * p[2]
        low, high, outwards = np.inf, -np.inf, 0.0
        for k in range(8):
            along = x * nodes[k, 0] + y * nodes[k, 1] + z * nodes[k, 2]
            low, high = min(low, along), max(high, along)
            outwards += along if (k & bit != 0) == (side == 1) else -along
        slack = _NEAR * (high - low)
        if (outwards > 0 and at > high + slack) or (outwards < 0 and at < low - slack):
            return True
    return False


class _Scratch(NamedTuple):
    """Arrays for `_search`, made once."""

    boxes: F64
    away: F64
    derivatives: F64
    points: F64


@jit
def _search(nodes: F64, p: F64, scratch: _Scratch, place: F64) -> bool:
    """Find the place of a point in a hexahedron whose determinant is positive in it, by halving; whether there is one.

    A box of places maps into the hull of its corners' points, and its derivatives lie in that of those along its edges.
    With both multiplied by the inverse of the derivative in its middle, a box is done with when the point is outside of
    that hull, or when derivatives are so near to one that steps in the box lead to the only place there can be.
    """
    if _beside(nodes, p):
        return False
    boxes, away = scratch.boxes, scratch.away
    d, inverse, q, x = scratch.derivatives[0], scratch.derivatives[1], scratch.points[0], scratch.points[1]
    lower, upper = scratch.points[2], scratch.points[3]
    boxes[0, 0], boxes[0, 1], left = -_NEAR, 1.0 + _NEAR, 1
    while left > 0:
        left -= 1
        lower[:], upper[:] = boxes[left, 0], boxes[left, 1]
        x[:] = 0.5 * (lower + upper)
        det = point_and_volume(nodes, x[0], x[1], x[2], q, d)
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            for k in range(3):
                one, two = (k + 1) % 3, (k + 2) % 3  # rows of d are axes
                inverse[k, a] = (d[one, b] * d[two, c] - d[two, b] * d[one, c]) / det
        for n in range(8):
            point_and_volume(
                nodes,
                upper[0] if n & 4 else lower[0],
                upper[1] if n & 2 else lower[1],
                upper[2] if n & 1 else lower[2],
                q,
                d,
            )
            for a in range(3):
                away[n, a] = (
                    inverse[a, 0] * (q[0] - p[0]) + inverse[a, 1] * (q[1] - p[1]) + inverse[a, 2] * (q[2] - p[2])
                )
        outside, strayed = False, 0.0
        for a in range(3):
            low, high, row = np.inf, -np.inf, 0.0
            for n in range(8):
                low, high = min(low, away[n, a]), max(high, away[n, a])
            outside = outside or low > _NEAR or high < -_NEAR
            for b in range(3):
                bit, most = 4 >> b, 0.0
                for n in range(8):
                    if n & bit == 0:
                        slope = (away[n + bit, a] - away[n, a]) / (upper[b] - lower[b])
                        most = max(most, abs(slope - (1.0 if a == b else 0.0)))
                row += most
            strayed = max(strayed, row)
        if outside:
            continue
        if strayed < 0.5:
            off, distance = np.inf, max(upper[0] - lower[0], upper[1] - lower[1], upper[2] - lower[2])
            for _ in range(STEPS + 10):
                point_and_volume(nodes, x[0], x[1], x[2], q, d)
                off, moved = 0.0, 0.0
                for a in range(3):
                    step = inverse[a, 0] * (p[0] - q[0]) + inverse[a, 1] * (p[1] - q[1]) + inverse[a, 2] * (p[2] - q[2])
                    to = min(max(x[a] + step, lower[a]), upper[a])
                    off, moved = max(off, abs(step)), max(moved, abs(to - x[a]))
                    x[a] = to
                # each step halves the distance from a place in the box, and no step is longer than 1.5 times that
                if moved < _DONE or off > distance:
                    break
                distance = max(0.5 * distance, _NEAR)
            if off < _NEAR:
                place[:] = x
                return True
        elif left + 2 <= _BOXES:
            along = 0
            for a in range(1, 3):
                if upper[a] - lower[a] > upper[along] - lower[along]:
                    along = a
            for k in range(2):
                boxes[left + k, 0], boxes[left + k, 1] = lower, upper
                boxes[left + k, 1 - k, along] = 0.5 * (lower[along] + upper[along])
            left += 2
    return False


@jit
def point_and_volume(nodes: F64, x: float, y: float, z: float, p: F64, d: F64) -> float:
    """Put the point at a place in a hexahedron (8, 3) into `p`, the derivative into `d`, and return its determinant."""
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


def points_and_volumes(corners: F64, cell: NDArray[np.integer], places: F64) -> tuple[F64, F64]:
    """As `points_in`, but with the size of the determinant, (n,), in place of the derivative."""
    nodes = np.ascontiguousarray(corners.reshape(-1, 8, 3))
    return _points_and_volumes(nodes, cell.astype(np.int64), np.ascontiguousarray(places))


@jit
def _points_and_volumes(nodes: F64, cell: I64, places: F64) -> tuple[F64, F64]:
    points, volumes, d = np.empty((len(cell), 3)), np.empty(len(cell)), np.empty((3, 3))
    for n in range(len(cell)):
        volumes[n] = abs(point_and_volume(nodes[cell[n]], places[n, 0], places[n, 1], places[n, 2], points[n], d))
    return points, volumes
