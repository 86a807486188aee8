"""Voronoi cells of pores, one by one: the box around a pore, clipped by the planes halfway to its neighbors.

A cell is kept in its dual form (as by Ray, Sokolov, Lefebvre and Lévy, "Meshless Voronoi on the GPU", ACM Transactions
on Graphics 37, 2018): each corner is a triple of planes. Neighbors come nearest first, and the cell is finished when
the next one lies more than twice as far as its farthest corner. Cells are independent of each other: one needs only
the pores within twice the largest empty radius.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit

#: Planes of the box that a cell is cut from.
BOX_PLANES = 6
# Distance beyond a plane, as a fraction of the box, from which on a corner is cut off: degenerate corners of lattices
# stay, and no face moves by more. Some 5000 times double precision; not measured.
_TOLERANCE = 1e-12
# Initial capacity in planes and corners, doubled on demand; cells of random pores have some 15 faces.
_CAPACITY = 128
# Radius of the first shell of the search for neighbors, in mean spacings, and growth of the next ones. Larger shells
# sort more pores that do not cut the cell, smaller ones scan the list more often; not measured.
_FIRST_SHELL, _SHELL_GROWTH = 1.4, 1.4


class VoronoiCells(NamedTuple):
    """Cells of some pores as sets of planes; inside is ``n . (x - center) <= offset`` for all."""

    centers: F64  # (n, 3), the pores
    first: I64  # (n + 1,), index of the first plane of each cell
    planes: F64  # (m, 4), unit normal n and offset of each face that is shared with another cell
    lower: F64  # (n, 3), boxes around the cells
    upper: F64


def voronoi_cells(points: F64, owners: I64, empty: float) -> VoronoiCells:
    """Voronoi cells of some pores, the `owners` (k,), of `points` (n, 3), among which are all within ``2 empty`` of an
    owner.

    `empty` is an upper bound of the distance of a point from its nearest pore: cells end that far from their pore
    along each axis, which is no face, and pores more than twice as far apart share none. Coincident pores count as
    one.
    """
    order = np.argsort(points[:, 0], kind="stable")
    along_x = np.ascontiguousarray(points[order])
    spacing = _mean_spacing(points)
    room = _CAPACITY
    while True:
        work = (
            np.empty((room, 4)), np.empty((room, 3)), np.empty((room, 3), np.int32), np.empty((room, 2), np.int32),
            np.empty(len(points)), np.empty(len(points), np.int64),
        )  # fmt: skip
        planes = np.empty((len(owners) * 24 + room, 4))  # 15 faces on average; more memory follows on demand
        first = np.zeros(len(owners) + 1, np.int64)
        lower, upper = np.empty((len(owners), 3)), np.empty((len(owners), 3))
        while True:
            done = _clip_all(along_x, points[owners], empty, spacing, *work, first, planes, lower, upper)
            if done != _MORE_PLANES:
                break
            planes = np.empty((2 * len(planes), 4))
        if done != _MORE_ROOM:
            break
        room *= 2
    centers = np.ascontiguousarray(points[owners])
    return VoronoiCells(centers, first, planes[: first[-1]].copy(), centers + lower, centers + upper)


def _mean_spacing(points: F64) -> float:
    """Cube root of the volume per point."""
    extent = np.maximum(np.ptp(points, axis=0), 1e-6) if len(points) else np.ones(3)
    return float((extent.prod() / max(len(points), 1)) ** (1 / 3))


_DONE, _MORE_PLANES, _MORE_ROOM = 0, 1, 2


@jit
def _clip_all(
    points: F64, centers: F64, empty: float, spacing: float, face: F64, corner: F64, triple: I32, rim: I32,
    distance: F64, near: I64, first: I64, planes: F64, lower: F64, upper: F64,
) -> int:  # fmt: skip
    """Clip the boxes of all centers; `points` are sorted along x. The arrays from `face` to `near` are work space."""
    total = 0
    for k in range(len(centers)):
        cx, cy, cz = centers[k, 0], centers[k, 1], centers[k, 2]
        corners = _box(face, corner, triple, empty)
        faces = BOX_PLANES
        inner, outer = 0.0, min(_FIRST_SHELL * spacing, 2.0 * empty)
        while True:
            found = _shell(points, cx, cy, cz, inner, outer, distance, near)
            reach = _farthest(corner, corners)
            for c in range(found):
                if distance[c] > 4.0 * reach:  # squares: its plane lies beyond the farthest corner
                    break
                p = near[c]
                length = math.sqrt(distance[c])
                nx, ny, nz = (points[p, 0] - cx) / length, (points[p, 1] - cy) / length, (points[p, 2] - cz) / length
                if faces == len(face):
                    return _MORE_ROOM
                face[faces, 0], face[faces, 1], face[faces, 2], face[faces, 3] = nx, ny, nz, 0.5 * length
                left = _cut(face, faces, corner, triple, rim, corners, _TOLERANCE * empty)
                if left < 0:
                    return _MORE_ROOM
                # keep the plane if it cut: where it left as many corners as before, the last one names it
                if left != corners or triple[left - 1, 2] == faces:
                    corners = left
                    faces += 1
                    reach = _farthest(corner, corners)
            if outer >= 2.0 * empty or outer * outer >= 4.0 * reach:
                break
            inner, outer = outer, min(_SHELL_GROWTH * outer, 2.0 * empty)
        if total + faces > len(planes):
            return _MORE_PLANES
        # later planes may have cut a face off entirely: those with a corner remain
        for f in range(BOX_PLANES, faces):
            for v in range(corners):
                if triple[v, 0] == f or triple[v, 1] == f or triple[v, 2] == f:
                    planes[total] = face[f]
                    total += 1
                    break
        first[k + 1] = total
        for a in range(3):
            lower[k, a] = corner[0, a]
            upper[k, a] = corner[0, a]
            for v in range(1, corners):
                lower[k, a] = min(lower[k, a], corner[v, a])
                upper[k, a] = max(upper[k, a], corner[v, a])
    return _DONE


@jit
def _box(face: F64, corner: F64, triple: I32, half: float) -> int:
    """Write the box |x|, |y|, |z| <= half and return its number of corners; triples are oriented alike from outside."""
    for a in range(3):
        for side in range(2):
            f = 2 * a + side
            face[f, 0], face[f, 1], face[f, 2], face[f, 3] = 0.0, 0.0, 0.0, half
            face[f, a] = 1.0 if side else -1.0
    for v in range(8):
        x, y, z = v & 1, (v >> 1) & 1, v >> 2
        corner[v, 0] = half if x else -half
        corner[v, 1] = half if y else -half
        corner[v, 2] = half if z else -half
        triple[v, 0] = x
        even = (x + y + z) % 2 == 1
        triple[v, 1] = 2 + y if even else 4 + z
        triple[v, 2] = 4 + z if even else 2 + y
    return 8


@jit
def _farthest(corner: F64, corners: int) -> float:
    """Squared distance of the farthest corner."""
    found = 0.0
    for v in range(corners):
        found = max(found, corner[v, 0] ** 2 + corner[v, 1] ** 2 + corner[v, 2] ** 2)
    return found


@jit
def _shell(points: F64, cx: float, cy: float, cz: float, inner: float, outer: float, distance: F64, near: I64) -> int:
    """Points with inner < distance <= outer, nearest first; `distance` receives their squares."""
    found = 0
    low = np.searchsorted(points[:, 0], cx - outer)
    for p in range(low, len(points)):
        dx = points[p, 0] - cx
        if dx > outer:
            break
        d = dx * dx + (points[p, 1] - cy) ** 2 + (points[p, 2] - cz) ** 2
        if d <= inner * inner or d > outer * outer or d <= 1e-24:  # the pore itself, and those at its place
            continue
        i = found
        while i > 0 and distance[i - 1] > d:
            distance[i] = distance[i - 1]
            near[i] = near[i - 1]
            i -= 1
        distance[i] = d
        near[i] = p
        found += 1
    return found


@jit
def _cut(face: F64, new: int, corner: F64, triple: I32, rim: I32, corners: int, tolerance: float) -> int:
    """Cut a cell by the plane `new`; returns the number of its corners, -1 if the arrays are too small."""
    nx, ny, nz, offset = face[new, 0], face[new, 1], face[new, 2], face[new, 3]
    kept = 0
    # move the corners that are cut off to the end
    last = corners
    while kept < last:
        if corner[kept, 0] * nx + corner[kept, 1] * ny + corner[kept, 2] * nz - offset > tolerance:
            last -= 1
            for a in range(3):
                corner[kept, a], corner[last, a] = corner[last, a], corner[kept, a]
                triple[kept, a], triple[last, a] = triple[last, a], triple[kept, a]
        else:
            kept += 1
    if kept == corners:
        return corners
    # edges between a removed corner and a remaining one: those between two removed ones come twice and cancel
    edges = 0
    for v in range(kept, corners):
        for side in range(3):
            a, b = triple[v, side], triple[v, (side + 1) % 3]
            shared = False
            for e in range(edges):
                if rim[e, 0] == b and rim[e, 1] == a:
                    edges -= 1
                    rim[e, 0], rim[e, 1] = rim[edges, 0], rim[edges, 1]
                    shared = True
                    break
            if not shared:
                if edges == len(rim):
                    return -1
                rim[edges, 0], rim[edges, 1] = a, b
                edges += 1
    if kept + edges > len(corner):
        return -1
    for e in range(edges):
        v = kept + e
        triple[v, 0], triple[v, 1], triple[v, 2] = rim[e, 0], rim[e, 1], new
        _meet(face, rim[e, 0], rim[e, 1], new, corner[v])
    return kept + edges


@jit
def _meet(face: F64, a: int, b: int, c: int, out: F64) -> None:
    """Intersect three planes in a point."""
    ux, uy, uz = face[a, 0], face[a, 1], face[a, 2]
    vx, vy, vz = face[b, 0], face[b, 1], face[b, 2]
    wx, wy, wz = face[c, 0], face[c, 1], face[c, 2]
    x, y, z = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
    det = ux * x + uy * y + uz * z
    # planes that are parallel to rounding meet far outside; the cell stays too large there, never too small
    if abs(det) < 1e-14:
        det = 1e-14 if det >= 0.0 else -1e-14
    p, q, r = face[a, 3], face[b, 3], face[c, 3]
    out[0] = (p * x + q * (wy * uz - wz * uy) + r * (uy * vz - uz * vy)) / det
    out[1] = (p * y + q * (wz * ux - wx * uz) + r * (uz * vx - ux * vz)) / det
    out[2] = (p * z + q * (wx * uy - wy * ux) + r * (ux * vy - uy * vx)) / det
