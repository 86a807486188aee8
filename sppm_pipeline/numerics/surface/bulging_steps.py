"""The steps of `bulging`: normals, rises, moving, and what is passed on; each for the triangles or vertices of a piece.

`vertices` and the other arrays of a window begin with vertex number `base`; a corner -1 - p stands for points[p].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN
from sppm_pipeline.numerics.surface.placing import DOMAIN

MOST = 0.3
"""Vertices are moved by at most this fraction of their shortest edge; a choice that keeps triangles in shape."""

LEAST_SLOPE = 0.3
"""Least cosine between normal and grid edge that the way along the edge is reckoned with; a choice."""

NEGLIGIBLE = 3e-4
"""What is left to move is dropped below this fraction of the spacing; so little is not worth being passed on."""


@jit
def find_borders(vertices: NDArray[np.float64], box: NDArray[np.float64], borders: NDArray[np.uint8]) -> None:
    for v in range(vertices.shape[0]):
        sides = 0
        for axis in range(3):
            for side in range(2):
                if abs(vertices[v, axis] - box[side, axis]) < 1e-9:
                    sides |= 1 << (2 * axis + side)
        borders[v] = np.uint8(sides)


# Arrays are handed over one by one, and hardly any functions called: Numba counts references to arrays in tuples and in
# what it does not see through, which took most of the time.


@jit
def _corners(
    faces: NDArray[np.int32],
    f: int,
    base: int,
    vertices: NDArray[np.float64],
    points: NDArray[np.float64],
    corners: NDArray[np.float64],
) -> bool:
    """Where the corners of a triangle lie, into `corners` (3, 3); whether one of them is on a rim."""
    on_rim = False
    for c in range(3):
        v = np.int64(faces[f, c])
        if v >= 0:
            for axis in range(3):
                corners[c, axis] = vertices[v - base, axis]
        else:
            on_rim = True
            for axis in range(3):
                corners[c, axis] = points[-1 - v, axis]
    return on_rim


@jit
def add_normals(
    vertices: NDArray[np.float64],
    borders: NDArray[np.uint8],
    normals: NDArray[np.float32],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    base: int,
    scale: float,
) -> None:
    corners, weights = np.empty((3, 3)), np.empty(3)
    for f in range(faces.shape[0]):
        on_rim = _corners(faces, f, base, vertices, points, corners)
        if not on_rim and borders[faces[f, 0] - base] & borders[faces[f, 1] - base] & borders[faces[f, 2] - base]:
            continue  # a cap
        ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
        vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
        ww = uu + vv - 2.0 * (ux * vx + uy * vy + uz * vz)
        if not min(uu, vv, ww) > 0.0:
            continue
        # these weights give the normals of a sphere however it is cut into triangles (Max 1999)
        weight = scale / (uu * vv * ww)
        weights[0], weights[1], weights[2] = weight * ww, weight * vv, weight * uu
        for c in range(3):
            v = np.int64(faces[f, c]) - base
            if not on_rim or faces[f, c] >= 0:
                normals[v, 0] += np.float32(x * weights[c])
                normals[v, 1] += np.float32(y * weights[c])
                normals[v, 2] += np.float32(z * weights[c])


@jit
def to_unit_length(normals: NDArray[np.float32]) -> None:
    for v in range(normals.shape[0]):
        length2 = normals[v, 0] * normals[v, 0] + normals[v, 1] * normals[v, 1] + normals[v, 2] * normals[v, 2]
        if length2 > np.float32(0.0):
            share = np.float32(1.0) / np.sqrt(length2)
            for axis in range(3):
                normals[v, axis] *= share


@jit
def add_rises(
    vertices: NDArray[np.float64],
    borders: NDArray[np.uint8],
    normals: NDArray[np.float32],
    rise: NDArray[np.float32],
    share: NDArray[np.float32],
    room: NDArray[np.float32],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    base: int,
) -> None:
    """Add up what triangles rise, and find the shortest edges."""
    corners, turned, lengths2 = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for f in range(faces.shape[0]):
        if kinds.size > 0 and kinds[f] == DOMAIN:
            for c in range(3):
                if faces[f, c] >= 0:
                    room[faces[f, c] - base] = np.float32(0.0)
            continue
        on_rim = _corners(faces, f, base, vertices, points, corners)
        if not on_rim and borders[faces[f, 0] - base] & borders[faces[f, 1] - base] & borders[faces[f, 2] - base]:
            continue
        movable = 0
        for c in range(3):
            v = np.int64(faces[f, c])
            if v >= 0:
                movable += 1
                for axis in range(3):
                    turned[c, axis] = normals[v - base, axis]
            else:
                for axis in range(3):
                    turned[c, axis] = 0.0
        if movable == 0:
            continue
        total = 0.0
        for c in range(3):
            d = c + 1 if c < 2 else 0
            ux, uy, uz = corners[d, 0] - corners[c, 0], corners[d, 1] - corners[c, 1], corners[d, 2] - corners[c, 2]
            lengths2[c] = ux * ux + uy * uy + uz * uz
            here = turned[c, 0] * ux + turned[c, 1] * uy + turned[c, 2] * uz
            there = turned[d, 0] * ux + turned[d, 1] * uy + turned[d, 2] * uz
            if on_rim:
                # a normal on a rim says nothing: there the surface is continued with the curvature at the other end
                if faces[f, d] < 0:
                    here *= 2.0
                if faces[f, c] < 0:
                    there *= 2.0
                # what is beside a rim stays within the domain
                if faces[f, c] < 0 or faces[f, d] < 0:
                    lengths2[c] = 0.0
            total += there - here
        ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
        vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(x * x + y * y + z * z)
        for c in range(3):
            if on_rim and faces[f, c] < 0:
                continue
            v = np.int64(faces[f, c]) - base
            rise[v] += np.float32(area * total / (8.0 * movable))
            share[v] += np.float32(area)
            room[v] = min(room[v], np.float32(min(lengths2[c], lengths2[c - 1 if c > 0 else 2])))


@jit
def move(
    vertices: NDArray[np.float64],
    borders: NDArray[np.uint8],
    normals: NDArray[np.float32],
    rise: NDArray[np.float32],
    more: NDArray[np.float32],
    share: NDArray[np.float32],
    room: NDArray[np.float32],
    taken: NDArray[np.float32],
    first: int,
    stop: int,
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    wholly: bool,
) -> None:
    """Move vertices as far as they should, or else have to for their neighbors; `rise` keeps what is left to move.

    They move along their edges of the grid, so that they come to lie higher by the wanted way. Those on the border of
    the grid stay. How far a vertex was moved is taken from its `room`.
    """
    least = NEGLIGIBLE * min(spacing[0], spacing[1], spacing[2])
    for v in range(first, stop):
        taken[v] = np.float32(0.0)
        if wholly:
            room[v] = np.float32(MOST) * np.sqrt(room[v])
            if share[v] > 0.0:
                rise[v] /= share[v]
        wanted = np.float64(rise[v] if wholly else more[v])
        rise[v], more[v] = np.float32(0.0), np.float32(0.0)
        if wanted == 0.0 or not share[v] > 0.0:
            continue
        if room[v] > 0.0:
            axis, inside = 0, 0
            place = 0.0
            for a in range(3):
                along = (vertices[v, a] - low[a]) / spacing[a]
                if abs(along - np.floor(along + 0.5)) > 0.75 * EDGE_MARGIN:
                    axis, place = a, along
                    inside += 1
            if inside != 1 or borders[v] != 0:
                room[v] = np.float32(0.0)
            else:
                slope, most = np.float64(normals[v, axis]), np.float64(room[v])
                way = wanted * slope / max(slope * slope, LEAST_SLOPE**2)
                way = min(max(way, -most), most) / spacing[axis]
                start = place - np.floor(place)
                way = min(max(start + way, EDGE_MARGIN), 1.0 - EDGE_MARGIN) - start
                vertices[v, axis] += way * spacing[axis]
                room[v] -= np.float32(abs(way) * spacing[axis])
                wanted -= way * spacing[axis] * slope
        if abs(wanted) > least:
            rise[v] = np.float32(wanted)


@jit
def find_takers(
    vertices: NDArray[np.float64],
    rise: NDArray[np.float32],
    room: NDArray[np.float32],
    taken: NDArray[np.float32],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    base: int,
) -> None:
    """Add up the triangles that have a corner to which another one can leave something."""
    corners = np.empty((3, 3))
    for f in range(faces.shape[0]):
        some, movable = False, 0
        for c in range(3):
            v = np.int64(faces[f, c])
            if v >= 0:
                some |= bool(rise[v - base] != 0.0)
                movable += int(room[v - base] > 0.0)
        if not some or movable == 0 or (kinds.size > 0 and kinds[f] == DOMAIN):
            continue
        _corners(faces, f, base, vertices, points, corners)
        ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
        vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(x * x + y * y + z * z)
        for c in range(3):
            v = np.int64(faces[f, c])
            if v >= 0 and rise[v - base] != 0.0 and movable > (room[v - base] > 0.0):
                taken[v - base] += np.float32(area)


@jit
def pass_on(
    vertices: NDArray[np.float64],
    rise: NDArray[np.float32],
    more: NDArray[np.float32],
    share: NDArray[np.float32],
    room: NDArray[np.float32],
    taken: NDArray[np.float32],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    base: int,
) -> None:
    """Leave what vertices can't be moved to their neighbors, by the areas of the triangles between them.

    The volume is kept: where only some of the triangles have a corner that can be moved, these get it all.
    """
    corners, left = np.empty((3, 3)), np.empty(3)
    for f in range(faces.shape[0]):
        some = False
        for c in range(3):
            v = np.int64(faces[f, c])
            left[c] = rise[v - base] if v >= 0 else 0.0
            some |= left[c] != 0.0
        if not some or (kinds.size > 0 and kinds[f] == DOMAIN):
            continue
        _corners(faces, f, base, vertices, points, corners)
        ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
        vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(x * x + y * y + z * z)
        for c in range(3):
            if left[c] == 0.0:
                continue
            w, u = np.int64(faces[f, (c + 1) % 3]), np.int64(faces[f, (c + 2) % 3])
            to_w, to_u = w >= 0 and room[w - base] > 0.0, u >= 0 and room[u - base] > 0.0
            if not to_w and not to_u:
                continue
            v = np.int64(faces[f, c]) - base
            part = left[c] * area * share[v] / taken[v] * (0.5 if to_w and to_u else 1.0)
            if to_w:
                more[w - base] += np.float32(part / share[w - base])
            if to_u:
                more[u - base] += np.float32(part / share[u - base])
