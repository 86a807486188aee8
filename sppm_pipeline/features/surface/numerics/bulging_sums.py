"""Steps of `bulging` that add up what triangles know: normals of vertices, how far to move them, shortest edges.

`vertices` and the other arrays of a window begin with vertex number `base`; a corner -1 - p stands for points[p]. What
triangles add is computed for some of them side by side, and added one by one, in their order.
"""

from __future__ import annotations

import math

import numpy as np

from sppm_pipeline.features.surface.numerics.placing import DOMAIN
from sppm_pipeline.services.arrays import F32, F64, I32, U8
from sppm_pipeline.services.jit.compiled import jit

AT_ONCE = 64
"""Triangles or vertices whose numbers are worked on side by side, between reading and adding up one by one."""

SIDES = np.uint8(63)
"""Of a vertex's place: the sides of the grid it lies on."""


# Arrays are handed over one by one, and hardly any functions called: Numba counts references to arrays in tuples and in
# what it does not see through, which took most of the time. Indices are unsigned, as others might count from the end.


@jit
def find_corners(faces: I32, f: int, base: int, vertices: F64, points: F64, corners: F64) -> bool:
    """Write the corners of a triangle into `corners` (3, 3); return whether one of them is on a rim."""
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
def add_normals(vertices: F64, places: U8, normals: F32, points: F64, faces: I32, base: int, scale: float) -> None:
    corners, begin, lanes = np.empty((3, 3)), np.uint64(base), np.uint64(AT_ONCE)
    ids, sides, out = np.empty(3 * AT_ONCE, np.uint64), np.empty(6 * AT_ONCE), np.empty(9 * AT_ONCE, np.float32)
    f = int(np.int64(0))
    while f < faces.shape[0]:
        n, rim = np.uint64(0), -1
        while f < faces.shape[0] and n < lanes and rim < 0:
            a, b, c = np.uint64(faces[f, 0]) - begin, np.uint64(faces[f, 1]) - begin, np.uint64(faces[f, 2]) - begin
            if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0:
                rim = f
            # caps are flat: their normals say nothing of the curved surface beside them
            elif not places[a] & places[b] & places[c] & SIDES:  # else a cap
                x, y, z = vertices[a, 0], vertices[a, 1], vertices[a, 2]
                sides[n], sides[lanes + n] = vertices[b, 0] - x, vertices[b, 1] - y
                sides[2 * lanes + n], sides[3 * lanes + n] = vertices[b, 2] - z, vertices[c, 0] - x
                sides[4 * lanes + n], sides[5 * lanes + n] = vertices[c, 1] - y, vertices[c, 2] - z
                ids[n], ids[lanes + n], ids[2 * lanes + n] = a, b, c
                n += np.uint64(1)
            f += 1
        _weigh_normals(sides, n, scale, out)
        for i in range(n):
            a, b, c = ids[i], ids[lanes + i], ids[2 * lanes + i]
            normals[a, 0] += out[i]
            normals[a, 1] += out[lanes + i]
            normals[a, 2] += out[2 * lanes + i]
            normals[b, 0] += out[3 * lanes + i]
            normals[b, 1] += out[4 * lanes + i]
            normals[b, 2] += out[5 * lanes + i]
            normals[c, 0] += out[6 * lanes + i]
            normals[c, 1] += out[7 * lanes + i]
            normals[c, 2] += out[8 * lanes + i]
        if rim < 0:
            continue
        find_corners(faces, rim, base, vertices, points, corners)
        for axis in range(3):
            sides[np.uint64(axis) * lanes] = corners[1, axis] - corners[0, axis]
            sides[np.uint64(3 + axis) * lanes] = corners[2, axis] - corners[0, axis]
        _weigh_normals(sides, np.uint64(1), scale, out)
        for corner in range(3):
            if faces[rim, corner] >= 0:
                for axis in range(3):
                    normals[faces[rim, corner] - base, axis] += out[np.uint64(3 * corner + axis) * lanes]


@jit
def _weigh_normals(sides: F64, n: np.uint64, scale: float, out: F32) -> None:
    """Of two sides of each of n triangles, what they add to the normals of their corners."""
    lanes, nothing = np.uint64(AT_ONCE), np.float32(0.0)
    for i in range(n):
        ux, uy, uz = sides[i], sides[lanes + i], sides[2 * lanes + i]
        vx, vy, vz = sides[3 * lanes + i], sides[4 * lanes + i], sides[5 * lanes + i]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
        ww = uu + vv - 2.0 * (ux * vx + uy * vy + uz * vz)
        whole = (uu > 0.0) & (vv > 0.0) & (ww > 0.0)
        # these weights give the normals of a sphere however it is cut into triangles (Max 1999)
        weight = scale / (uu * vv * ww)
        first, second, third = weight * ww, weight * vv, weight * uu
        out[i] = np.float32(x * first) if whole else nothing
        out[lanes + i] = np.float32(y * first) if whole else nothing
        out[2 * lanes + i] = np.float32(z * first) if whole else nothing
        out[3 * lanes + i] = np.float32(x * second) if whole else nothing
        out[4 * lanes + i] = np.float32(y * second) if whole else nothing
        out[5 * lanes + i] = np.float32(z * second) if whole else nothing
        out[6 * lanes + i] = np.float32(x * third) if whole else nothing
        out[7 * lanes + i] = np.float32(y * third) if whole else nothing
        out[8 * lanes + i] = np.float32(z * third) if whole else nothing


@jit
def to_unit_length(normals: F32) -> None:
    for v in range(normals.shape[0]):
        length2 = normals[v, 0] * normals[v, 0] + normals[v, 1] * normals[v, 1] + normals[v, 2] * normals[v, 2]
        if length2 > np.float32(0.0):
            share = np.float32(1.0) / np.sqrt(length2)
            for axis in range(3):
                normals[v, axis] *= share


@jit
def add_rises(
    vertices: F64, places: U8, normals: F32, rise: F32, share: F32, room: F32, points: F64, faces: I32, kinds: U8,
    base: int,
) -> None:  # fmt: skip
    """Add up what triangles rise, and find the shortest edges."""
    corners, turned, lengths2 = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    begin, lanes = np.uint64(base), np.uint64(AT_ONCE)
    ids, sides = np.empty(3 * AT_ONCE, np.uint64), np.empty(9 * AT_ONCE)
    ends, out = np.empty(9 * AT_ONCE, np.float32), np.empty(5 * AT_ONCE, np.float32)
    f = int(np.int64(0))
    while f < faces.shape[0]:
        n, other = np.uint64(0), -1
        while f < faces.shape[0] and n < lanes and other < 0:
            a, b, c = np.uint64(faces[f, 0]) - begin, np.uint64(faces[f, 1]) - begin, np.uint64(faces[f, 2]) - begin
            if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0 or (kinds.size > 0 and kinds[f] == DOMAIN):
                other = f
            elif not places[a] & places[b] & places[c] & SIDES:
                for axis in range(3):
                    at, along = np.uint64(axis) * lanes + n, np.uint64(axis)
                    sides[at] = vertices[b, along] - vertices[a, along]
                    sides[3 * lanes + at] = vertices[c, along] - vertices[b, along]
                    sides[6 * lanes + at] = vertices[a, along] - vertices[c, along]
                    ends[at], ends[3 * lanes + at] = normals[a, along], normals[b, along]
                    ends[6 * lanes + at] = normals[c, along]
                ids[n], ids[lanes + n], ids[2 * lanes + n] = a, b, c
                n += np.uint64(1)
            f += 1
        _find_rises(sides, ends, n, out)
        for i in range(n):
            a, b, c = ids[i], ids[lanes + i], ids[2 * lanes + i]
            way, weight = out[i], out[lanes + i]
            uu, vv, ww = out[2 * lanes + i], out[3 * lanes + i], out[4 * lanes + i]
            rise[a] += way
            rise[b] += way
            rise[c] += way
            share[a] += weight
            share[b] += weight
            share[c] += weight
            room[a] = min(room[a], min(uu, ww))
            room[b] = min(room[b], min(vv, uu))
            room[c] = min(room[c], min(ww, vv))
        if other < 0:
            continue
        if kinds.size > 0 and kinds[other] == DOMAIN:
            for corner in range(3):
                if faces[other, corner] >= 0:
                    room[faces[other, corner] - base] = np.float32(0.0)
        else:
            find_corners(faces, other, base, vertices, points, corners)
            _add_rise_at_rim(normals, rise, share, room, faces, other, base, corners, turned, lengths2)


@jit
def _find_rises(sides: F64, ends: F32, n: np.uint64, out: F32) -> None:
    """Rises of n triangles times their areas, twice their areas, and their squared sides, of sides and normals."""
    lanes = np.uint64(AT_ONCE)
    for i in range(n):
        ux, uy, uz = sides[i], sides[lanes + i], sides[2 * lanes + i]
        vx, vy, vz = sides[3 * lanes + i], sides[4 * lanes + i], sides[5 * lanes + i]
        wx, wy, wz = sides[6 * lanes + i], sides[7 * lanes + i], sides[8 * lanes + i]
        ax, ay, az = np.float64(ends[i]), np.float64(ends[lanes + i]), np.float64(ends[2 * lanes + i])
        bx, by, bz = np.float64(ends[3 * lanes + i]), np.float64(ends[4 * lanes + i]), np.float64(ends[5 * lanes + i])
        cx, cy, cz = np.float64(ends[6 * lanes + i]), np.float64(ends[7 * lanes + i]), np.float64(ends[8 * lanes + i])
        total = (bx * ux + by * uy + bz * uz) - (ax * ux + ay * uy + az * uz)
        total += (cx * vx + cy * vy + cz * vz) - (bx * vx + by * vy + bz * vz)
        total += (ax * wx + ay * wy + az * wz) - (cx * wx + cy * wy + cz * wz)
        # the edge from the first corner to the third is -w
        x, y, z = uz * wy - uy * wz, ux * wz - uz * wx, uy * wx - ux * wy
        area = math.sqrt(x * x + y * y + z * z)
        out[i], out[lanes + i] = np.float32(area * total / 24.0), np.float32(area)
        out[2 * lanes + i] = np.float32(ux * ux + uy * uy + uz * uz)
        out[3 * lanes + i] = np.float32(vx * vx + vy * vy + vz * vz)
        out[4 * lanes + i] = np.float32(wx * wx + wy * wy + wz * wz)


@jit
def _add_rise_at_rim(
    normals: F32, rise: F32, share: F32, room: F32, faces: I32, f: int, base: int, corners: F64, turned: F64,
    lengths2: F64,
) -> None:  # fmt: skip
    """`add_rises` for a triangle with a corner on a rim; the last two are room to work in."""
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
        return
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
