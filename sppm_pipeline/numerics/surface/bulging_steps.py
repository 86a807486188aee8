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


_SIDES, _NO_AXIS = np.uint8(63), 3
_LEFT, _MOVABLE = (
    np.uint8(1),
    np.uint8(2),
)  # of what `move` notes: that a vertex has something left to move, and that it can be moved


@jit
def find_places(
    vertices: NDArray[np.float64], box: NDArray[np.float64], spacing: NDArray[np.float64], places: NDArray[np.uint8]
) -> None:
    """On which sides of the grid vertices lie, as six bits, and above them the axis of their grid edge, or 3 for none.

    A vertex that is moved along its edge stays off the ends of it, so that this holds for good.
    """
    for v in range(vertices.shape[0]):
        sides, axis, inside = 0, _NO_AXIS, 0
        for a in range(3):
            for side in range(2):
                if abs(vertices[v, a] - box[side, a]) < 1e-9:
                    sides |= 1 << (2 * a + side)
            along = (vertices[v, a] - box[0, a]) / spacing[a]
            if abs(along - np.floor(along + 0.5)) > 0.75 * EDGE_MARGIN:
                axis = a
                inside += 1
        places[v] = np.uint8(sides | (axis if inside == 1 else _NO_AXIS) << 6)


# Arrays are handed over one by one, and hardly any functions called: Numba counts references to arrays in tuples and in
# what it does not see through, which took most of the time. Indices are unsigned, as others might count from the end.


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
    places: NDArray[np.uint8],
    normals: NDArray[np.float32],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    base: int,
    scale: float,
) -> None:
    corners, begin = np.empty((3, 3)), np.uint64(base)
    for f in range(faces.shape[0]):
        on_rim = (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0
        a, b, c = np.uint64(faces[f, 0]) - begin, np.uint64(faces[f, 1]) - begin, np.uint64(faces[f, 2]) - begin
        if on_rim:
            _corners(faces, f, base, vertices, points, corners)
            ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
            vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        elif places[a] & places[b] & places[c] & _SIDES:
            continue  # a cap
        else:
            ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
            vx, vy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
            uz, vz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
        ww = uu + vv - 2.0 * (ux * vx + uy * vy + uz * vz)
        if not min(uu, vv, ww) > 0.0:
            continue
        # these weights give the normals of a sphere however it is cut into triangles (Max 1999)
        weight = scale / (uu * vv * ww)
        for corner in range(3):
            if on_rim and faces[f, corner] < 0:
                continue
            v, of = (a, weight * ww) if corner == 0 else (b, weight * vv) if corner == 1 else (c, weight * uu)
            normals[v, 0] += np.float32(x * of)
            normals[v, 1] += np.float32(y * of)
            normals[v, 2] += np.float32(z * of)


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
    places: NDArray[np.uint8],
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
    corners, turned, lengths2, begin = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.uint64(base)
    for f in range(faces.shape[0]):
        if kinds.size > 0 and kinds[f] == DOMAIN:
            for corner in range(3):
                if faces[f, corner] >= 0:
                    room[faces[f, corner] - base] = np.float32(0.0)
            continue
        if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0:
            _corners(faces, f, base, vertices, points, corners)
            movable = 0
            for corner in range(3):
                v = np.int64(faces[f, corner])
                if v >= 0:
                    movable += 1
                    for axis in range(3):
                        turned[corner, axis] = normals[v - base, axis]
                else:
                    for axis in range(3):
                        turned[corner, axis] = 0.0
            if movable == 0:
                continue
            total = 0.0
            for corner in range(3):
                d = corner + 1 if corner < 2 else 0
                ux, uy, uz = (
                    corners[d, 0] - corners[corner, 0],
                    corners[d, 1] - corners[corner, 1],
                    corners[d, 2] - corners[corner, 2],
                )
                lengths2[corner] = ux * ux + uy * uy + uz * uz
                here = turned[corner, 0] * ux + turned[corner, 1] * uy + turned[corner, 2] * uz
                there = turned[d, 0] * ux + turned[d, 1] * uy + turned[d, 2] * uz
                # a normal on a rim says nothing: there the surface is continued with the curvature at the other end
                if faces[f, d] < 0:
                    here *= 2.0
                if faces[f, corner] < 0:
                    there *= 2.0
                # what is beside a rim stays within the domain
                if faces[f, corner] < 0 or faces[f, d] < 0:
                    lengths2[corner] = 0.0
                total += there - here
            ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
            vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            area = math.sqrt(x * x + y * y + z * z)
            for corner in range(3):
                if faces[f, corner] < 0:
                    continue
                v = np.int64(faces[f, corner]) - base
                rise[v] += np.float32(area * total / (8.0 * movable))
                share[v] += np.float32(area)
                room[v] = min(room[v], np.float32(min(lengths2[corner], lengths2[corner - 1 if corner > 0 else 2])))
            continue
        a, b, c = np.uint64(faces[f, 0]) - begin, np.uint64(faces[f, 1]) - begin, np.uint64(faces[f, 2]) - begin
        if places[a] & places[b] & places[c] & _SIDES:
            continue
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[b, 0], vertices[c, 1] - vertices[b, 1], vertices[c, 2] - vertices[b, 2]
        wx, wy, wz = vertices[a, 0] - vertices[c, 0], vertices[a, 1] - vertices[c, 1], vertices[a, 2] - vertices[c, 2]
        ax, ay, az = np.float64(normals[a, 0]), np.float64(normals[a, 1]), np.float64(normals[a, 2])
        bx, by, bz = np.float64(normals[b, 0]), np.float64(normals[b, 1]), np.float64(normals[b, 2])
        cx, cy, cz = np.float64(normals[c, 0]), np.float64(normals[c, 1]), np.float64(normals[c, 2])
        total = (bx * ux + by * uy + bz * uz) - (ax * ux + ay * uy + az * uz)
        total += (cx * vx + cy * vy + cz * vz) - (bx * vx + by * vy + bz * vz)
        total += (ax * wx + ay * wy + az * wz) - (cx * wx + cy * wy + cz * wz)
        # the edge from the first corner to the third is -w
        x, y, z = uz * wy - uy * wz, ux * wz - uz * wx, uy * wx - ux * wy
        area = math.sqrt(x * x + y * y + z * z)
        uu, vv, ww = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz
        way, weight = np.float32(area * total / 24.0), np.float32(area)
        rise[a] += way
        rise[b] += way
        rise[c] += way
        share[a] += weight
        share[b] += weight
        share[c] += weight
        room[a] = min(room[a], np.float32(min(uu, ww)))
        room[b] = min(room[b], np.float32(min(vv, uu)))
        room[c] = min(room[c], np.float32(min(ww, vv)))


@jit
def move(
    vertices: NDArray[np.float64],
    places: NDArray[np.uint8],
    normals: NDArray[np.float32],
    rise: NDArray[np.float32],
    more: NDArray[np.float32],
    share: NDArray[np.float32],
    room: NDArray[np.float32],
    taken: NDArray[np.float32],
    notes: NDArray[np.uint8],
    first: int,
    stop: int,
    low: NDArray[np.float64],
    spacing: NDArray[np.float64],
    wholly: bool,
) -> None:
    """Move vertices as far as they should, or else have to for their neighbors; `rise` keeps what is left to move.

    They move along their edges of the grid, so that they come to lie higher by the wanted way. Those on the border of
    the grid stay. How far a vertex was moved is taken from its `room`; what is true of it afterwards goes into `notes`.
    """
    least = NEGLIGIBLE * min(spacing[0], spacing[1], spacing[2])
    for number in range(first, stop):
        v = np.uint64(number)
        taken[v] = np.float32(0.0)
        if wholly:
            room[v] = np.float32(MOST) * np.sqrt(room[v])
            if share[v] > 0.0:
                rise[v] /= share[v]
        wanted = np.float64(rise[v] if wholly else more[v])
        rise[v], more[v] = np.float32(0.0), np.float32(0.0)
        if wanted != 0.0 and share[v] > 0.0:
            if room[v] > 0.0:
                axis = places[v] >> 6
                if places[v] & _SIDES or axis == _NO_AXIS:
                    room[v] = np.float32(0.0)
                else:
                    place = (vertices[v, axis] - low[axis]) / spacing[axis]
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
        notes[v] = np.uint8(_LEFT * (rise[v] != 0.0) | _MOVABLE * (room[v] > 0.0))


@jit
def find_takers(
    vertices: NDArray[np.float64],
    taken: NDArray[np.float32],
    notes: NDArray[np.uint8],
    points: NDArray[np.float64],
    faces: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    base: int,
    chosen: NDArray[np.int32],
    areas: NDArray[np.float64],
) -> int:
    """Add up the triangles that have a corner to which another one can leave something.

    Returns how many there are; their numbers and twice their areas go into `chosen` and `areas`, which have room for
    all.
    """
    n = int(np.int64(0))
    both, begin = np.uint8(_LEFT | _MOVABLE), np.uint64(base)
    for f in range(faces.shape[0]):
        some = np.uint8(0)
        if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0:
            for corner in range(3):
                if faces[f, corner] >= 0:
                    some |= notes[np.uint64(faces[f, corner]) - begin]
        else:
            some = notes[np.uint64(faces[f, 0]) - begin] | notes[np.uint64(faces[f, 1]) - begin]
            some |= notes[np.uint64(faces[f, 2]) - begin]
        if kinds.size > 0 and kinds[f] == DOMAIN:
            some = np.uint8(0)
        chosen[n] = f
        n += some == both
    corners = np.empty((3, 3))
    for i in range(n):
        f = chosen[i]
        if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0:
            _corners(faces, f, base, vertices, points, corners)
            ux, uy, uz = corners[1, 0] - corners[0, 0], corners[1, 1] - corners[0, 1], corners[1, 2] - corners[0, 2]
            vx, vy, vz = corners[2, 0] - corners[0, 0], corners[2, 1] - corners[0, 1], corners[2, 2] - corners[0, 2]
        else:
            a, b, c = np.uint64(faces[f, 0]) - begin, np.uint64(faces[f, 1]) - begin, np.uint64(faces[f, 2]) - begin
            ux, uy = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1]
            vx, vy = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1]
            uz, vz = vertices[b, 2] - vertices[a, 2], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        areas[i] = math.sqrt(x * x + y * y + z * z)
        area = np.float32(areas[i])
        movable = np.uint8(0)
        for corner in range(3):
            if faces[f, corner] >= 0:
                movable += notes[np.uint64(faces[f, corner]) - begin] >> 1
        for corner in range(3):
            if faces[f, corner] >= 0:
                taker = np.uint64(faces[f, corner]) - begin
                if notes[taker] & _LEFT and movable > notes[taker] >> 1:
                    taken[taker] += area
    return n


@jit
def pass_on(
    rise: NDArray[np.float32],
    more: NDArray[np.float32],
    share: NDArray[np.float32],
    taken: NDArray[np.float32],
    notes: NDArray[np.uint8],
    faces: NDArray[np.int32],
    base: int,
    chosen: NDArray[np.int32],
    areas: NDArray[np.float64],
) -> None:
    """Leave what vertices can't be moved to their neighbors, by the areas of the triangles between them.

    The volume is kept: where only some of the triangles have a corner that can be moved, these get it all. `chosen` and
    `areas` are what `find_takers` found of these faces.
    """
    begin = np.uint64(base)
    for i in range(chosen.size):
        f = chosen[i]
        for c in range(3):
            if faces[f, c] < 0:
                continue
            v = np.uint64(faces[f, c]) - begin
            if not notes[v] & _LEFT:
                continue
            d, e = (c + 1 if c < 2 else 0), (c - 1 if c > 0 else 2)
            w, u = np.uint64(faces[f, d]) - begin, np.uint64(faces[f, e]) - begin
            to_w = faces[f, d] >= 0 and notes[w] & _MOVABLE != 0
            to_u = faces[f, e] >= 0 and notes[u] & _MOVABLE != 0
            if not to_w and not to_u:
                continue
            part = np.float64(rise[v]) * areas[i] * share[v] / taken[v] * (0.5 if to_w and to_u else 1.0)
            if to_w:
                more[w] += np.float32(part / share[w])
            if to_u:
                more[u] += np.float32(part / share[u])
