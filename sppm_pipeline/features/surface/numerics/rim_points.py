"""The point at which two surfaces meet in a face of a cube.

In a face the domain is the line between the two places where its triangles pierce the sides of the face, and the other
field is followed along this line by a bicubic polynomial: its zero exists by its signs, however tangent the surfaces.
Two triangles of the domain meet where their planes do.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sppm_pipeline.features.surface.numerics.placing import DOMAIN, FIELD, Placed, cubic, first_place, sample_line
from sppm_pipeline.services.arrays import F32, F64, I32, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN

SHARP = math.cos(math.radians(25.0))
"""Triangles of the domain whose normals differ by more meet in a sharp edge, a heuristic: cylinders of 15 or more faces
are smooth. At half the angle facets of coarse meshes get rims of their own, at twice it chamfers are rounded."""


class Surfaces(NamedTuple):
    """Surfaces that meet in a part, as compiled code takes them; see `placing.Samples` and `crossings.Crossings`."""

    field: F32  # (planes, ny, nx), as domain and skin
    domain: F32
    skin: F32
    origin: F64
    spacing: F64
    shape: I64  # (4,), nodes along x, y, z, and the first plane of the samples
    crossed: I64  # edges of the grid that triangles of the domain pierce
    shares: F64  # where they are pierced, as fractions of the edge
    owners: I32  # by which triangle
    normals: F64  # of all triangles
    planes: F64  # (256, 6, 3, 4), `marching_tables.separations`


@jit
def _patch(values: F32, k: int, j: int, i: int, b: int, c: int, patch: F64) -> None:
    """The 4 x 4 samples around the face at node (k, j, i) that axes b and c span, rows along b."""
    n = values.shape[2 - c]
    at = (i, j, k)[c]
    for s in range(4):
        place = min(max(at + s - 1, 0), n - 1) - at
        sample_line(values, k + place * (c == 2), j + place * (c == 1), i + place * (c == 0), b, patch[s])
    for t in range(4):
        if at == 0:
            patch[0, t] = 2.0 * patch[1, t] - patch[2, t]
        if at + 2 >= n:
            patch[3, t] = 2.0 * patch[2, t] - patch[1, t]


@jit
def _bicubic(patch: F64, u: float, v: float) -> float:
    """Value at a place (u, v) in the middle of a patch, by the bicubic through its samples."""
    rows = (
        cubic(patch[0, 0], patch[0, 1], patch[0, 2], patch[0, 3], u),
        cubic(patch[1, 0], patch[1, 1], patch[1, 2], patch[1, 3], u),
        cubic(patch[2, 0], patch[2, 1], patch[2, 2], patch[2, 3], u),
        cubic(patch[3, 0], patch[3, 1], patch[3, 2], patch[3, 3], u),
    )
    return cubic(rows[0], rows[1], rows[2], rows[3], v)


@jit
def edge_node(edge: int, nx: int, ny: int, node: I64) -> int:
    """The node at which a grid edge begins, into `node`, and its axis."""
    place = edge // 3
    node[0], node[1], node[2] = place % nx, place // nx % ny, place // nx // ny
    return int(edge % 3)


@jit
def _solid(surfaces: Surfaces, i: int, j: int, k: int) -> bool:
    """Test whether a node is solid, islands included."""
    field, domain, skin = surfaces.field, surfaces.domain, surfaces.skin
    k -= surfaces.shape[3]
    return domain[k, j, i] < 0.0 and (field[k, j, i] < 0.0 or (skin.size > 0 and skin[k, j, i] < 0.0))


@jit
def _case_of_cube(cube: I64, surfaces: Surfaces) -> int:
    """The case of marching cubes; 0 outside of the grid."""
    for a in range(3):
        if cube[a] < 0 or cube[a] + 1 >= surfaces.shape[a]:
            return 0
    case = 0
    for corner in range(8):
        if _solid(surfaces, cube[0] + (corner & 1), cube[1] + (corner >> 1 & 1), cube[2] + (corner >> 2)):
            case |= 1 << corner
    return case


@jit
def _apart(planes: F64, axis: int, side: float, p: float, q: float) -> bool:
    """Test whether a place (p, q) in a face of the unit cube keeps apart what its `separations` (3, 4) keep apart."""
    for plane in range(3):
        a, b, c = planes[plane, axis], planes[plane, (axis + 1) % 3], planes[plane, (axis + 2) % 3]
        if a * side + b * p + c * q > planes[plane, 3]:
            return False
    return True


@jit
def _passed_twice(corner: I64, p: int, q: int, surfaces: Surfaces) -> bool:
    """Test whether the surface crosses all four sides of the face at a node that axes p and q span."""
    case = 0
    at = corner.copy()
    for turn in range(4):
        at[p] = corner[p] + (turn & 1)
        at[q] = corner[q] + (turn >> 1)
        if _solid(surfaces, at[0], at[1], at[2]):
            case |= 1 << turn
    return case in (6, 9)


@jit
def _lost_beyond(
    patch: F64, vertex: tuple[float, float], start: tuple[float, float], end: tuple[float, float], at_end: float
) -> float:
    """Area in a face between a surface and the rim it really reaches, which lies beyond the end of the face.

    The solid goes on along the line from start to end: no edge of the grid shows that, as it is void at both of its
    ends. The rim is looked for up to a voxel beyond, where the samples reach.
    """
    dp, dq = end[0] - start[0], end[1] - start[1]
    length = math.sqrt(dp * dp + dq * dq)
    dp, dq = dp / length, dq / length
    reach, before = 1.0, at_end
    for step in range(1, 5):
        value = _bicubic(patch, end[0] + 0.25 * step * dp, end[1] + 0.25 * step * dq)
        if not value < 0.0:
            reach = 0.25 * (step - 1 + before / (before - value))
            break
        before = value
    return float(0.5 * reach * abs((end[0] - vertex[0]) * dq - (end[1] - vertex[1]) * dp))


@jit
def _across(surfaces: Surfaces, corner: I64, normal: F64, flat: int) -> float:
    """The square of the cosine between a face's normal and the rim on it, where a plane meets the field."""
    i, j, k = corner[0], corner[1], corner[2] - surfaces.shape[3]
    i, j = min(i, surfaces.field.shape[2] - 2), min(j, surfaces.field.shape[1] - 2)
    k = min(k, surfaces.field.shape[0] - 2)
    at = np.float64(surfaces.field[k, j, i])
    x, y, z = surfaces.field[k, j, i + 1] - at, surfaces.field[k, j + 1, i] - at, surfaces.field[k + 1, j, i] - at
    rim = (normal[1] * z - normal[2] * y, normal[2] * x - normal[0] * z, normal[0] * y - normal[1] * x)
    length2 = rim[0] * rim[0] + rim[1] * rim[1] + rim[2] * rim[2]
    return float(rim[flat] * rim[flat] / length2) if length2 > 0.0 else 0.0


@jit
def meeting_point(a: int, b: int, cube: I64, placed: Placed, surfaces: Surfaces, point: F64) -> int:
    """The point at which the surfaces of two vertices on one face of a cube meet, and that face; -1 if they do not.

    Nor do they where the surface passes through the face twice, or where polygons in one of both cubes at the face
    would not be apart with that point, by `Surfaces.planes`. Faces are numbered 2 * axis + side within their cube; here
    the side is left out. `point[3]` gets the volume beyond the face that the mesh has none of, in voxels.
    """
    point[3] = 0.0
    vertices, edge, on, triangle = placed.vertices, placed.edge, placed.on, placed.triangle
    origin, spacing, shape, normals = surfaces.origin, surfaces.spacing, surfaces.shape, surfaces.normals
    crossed, owners = surfaces.crossed, surfaces.owners
    if on[a] == on[b] and on[a] != DOMAIN:
        return -1
    if on[a] != FIELD and on[b] != FIELD and on[a] != on[b]:
        return -1  # skin and domain are parallel
    na, nb = np.empty(3, np.int64), np.empty(3, np.int64)
    axis_a, axis_b = edge_node(edge[a], shape[0], shape[1], na), edge_node(edge[b], shape[0], shape[1], nb)
    flat = -1
    for d in range(3):
        if d != axis_a and d != axis_b and na[d] == nb[d]:
            flat = d
    if flat < 0:
        return -1
    p, q = (flat + 1) % 3, (flat + 2) % 3
    corner = np.empty(3, np.int64)
    for d in range(3):
        corner[d] = min(na[d], nb[d])
    if _passed_twice(corner, p, q, surfaces):
        return -1
    # places in the face, 0..1
    up = (vertices[a, p] - origin[p]) / spacing[p] - corner[p]
    uq = (vertices[a, q] - origin[q]) / spacing[q] - corner[q]
    vp = (vertices[b, p] - origin[p]) / spacing[p] - corner[p]
    vq = (vertices[b, q] - origin[q]) / spacing[q] - corner[q]
    at_p, at_q = 0.0, 0.0
    if on[a] == DOMAIN and on[b] == DOMAIN:
        ta, tb = triangle[a], triangle[b]
        if ta < 0 or tb < 0 or ta == tb:
            return -1
        m, n = normals[ta], normals[tb]
        if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] >= SHARP:
            return -1
        mp, mq, np_, nq = m[p] * spacing[p], m[q] * spacing[q], n[p] * spacing[p], n[q] * spacing[q]
        det = mp * nq - mq * np_
        # planes that are parallel within the face do not meet in a point of it
        if abs(det) < 1e-3 * math.sqrt((mp * mp + mq * mq) * (np_ * np_ + nq * nq)):
            return -1
        first, second = mp * up + mq * uq, np_ * vp + nq * vq
        at_p, at_q = (first * nq - mq * second) / det, (mp * second - first * np_) / det
        if min(at_p, at_q) < -0.5 or max(at_p, at_q) > 1.5:
            return -1
    else:
        other = b if on[a] == FIELD else a
        sp, sq = (vp, vq) if other == b else (up, uq)  # the line begins here, on domain or skin
        flat_values = surfaces.domain if on[other] == DOMAIN else surfaces.skin
        node = np.empty(3, np.int64)
        patch = np.empty((4, 4))
        _patch(surfaces.field, corner[2] - shape[3], corner[1], corner[0], p, q, patch)
        at_start = _bicubic(patch, sp, sq)
        found = False
        best = np.inf
        # where the line may leave: at the other crossings of the face's sides, or straight on along the triangle
        for side in range(5):
            ep, eq = -1.0, -1.0
            if side < 4:
                along, across_axis = (p, q) if side < 2 else (q, p)
                for d in range(3):
                    node[d] = corner[d]
                node[across_axis] += side % 2
                key = 3 * ((node[2] * shape[1] + node[1]) * shape[0] + node[0]) + along
                if key == edge[other]:
                    continue
                share = -1.0
                if on[other] == DOMAIN and triangle[other] >= 0:
                    r = first_place(crossed, key)
                    while r < crossed.size and crossed[r] == key:
                        m, n = normals[triangle[other]], normals[owners[r]]
                        if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] >= SHARP:
                            share = surfaces.shares[r]
                        r += 1
                else:
                    kz = node[2] - shape[3]
                    v0 = np.float64(flat_values[kz, node[1], node[0]])
                    v1 = np.float64(flat_values[kz + (along == 2), node[1] + (along == 1), node[0] + (along == 0)])
                    if (v0 < 0.0) != (v1 < 0.0):
                        share = v0 / (v0 - v1)
                if share < 0.0:
                    continue
                ep, eq = (share, float(side % 2)) if side < 2 else (float(side % 2), share)
            else:
                if found or on[other] != DOMAIN or triangle[other] < 0:
                    continue
                n = normals[triangle[other]]
                dp, dq = -n[q] * spacing[q], n[p] * spacing[p]
                longest = 0.0
                for turn in range(2):
                    sign = 1.0 - 2.0 * turn
                    reach = np.inf
                    for s, d in ((sp, sign * dp), (sq, sign * dq)):
                        if abs(d) > 1e-12:
                            reach = min(reach, ((1.0 if d > 0.0 else 0.0) - s) / d)
                    if np.isfinite(reach) and reach > longest:
                        longest = reach
                        ep, eq = sp + reach * sign * dp, sq + reach * sign * dq
                if longest == 0.0:
                    continue
            if (ep - sp) ** 2 + (eq - sq) ** 2 < 1e-12:
                continue
            at_end = _bicubic(patch, ep, eq)
            if (at_end < 0.0) == (at_start < 0.0):
                if not found and abs(at_end) < best:
                    best = abs(at_end)
                    at_p, at_q = ep, eq
                    if at_end < 0.0 and on[other] == DOMAIN and triangle[other] >= 0:
                        vertex = (up, uq) if other == b else (vp, vq)
                        lost = _lost_beyond(patch, vertex, (sp, sq), (ep, eq), at_end)
                        point[3] = lost * _across(surfaces, corner, normals[triangle[other]], flat)
                continue
            low, high, f_low, f_high = 0.0, 1.0, at_start, at_end
            t = 0.5
            # regula falsi with the value at the end that stays halved, as in the Illinois method: neither end
            # gets stuck
            for _ in range(40):
                t = low + (high - low) * f_low / (f_low - f_high)
                value = _bicubic(patch, sp + t * (ep - sp), sq + t * (eq - sq))
                if abs(value) <= 1e-4 * abs(at_end - at_start) or high - low < 1e-4:
                    break
                if (value < 0.0) == (f_low < 0.0):
                    low, f_low = t, value
                    f_high *= 0.5
                else:
                    high, f_high = t, value
                    f_low *= 0.5
            found = True
            point[3] = 0.0
            at_p, at_q = sp + t * (ep - sp), sq + t * (eq - sq)
            break
        if not found and not best < np.inf:
            at_p, at_q = 0.5 * (up + vp), 0.5 * (uq + vq)
    at_p = min(max(at_p, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
    at_q = min(max(at_q, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
    side = int(corner[flat] != cube[flat])
    # both cubes at the face must keep their polygons apart, or neither takes the point: the mesh stays
    # closed
    beyond = cube.copy()
    for _turn in range(2):
        case = _case_of_cube(beyond, surfaces)
        if not _apart(surfaces.planes[case, 2 * flat + side], flat, float(side), at_p, at_q):
            return -1
        beyond[flat] += 2 * side - 1
        side = 1 - side
    point[flat] = origin[flat] + corner[flat] * spacing[flat]
    point[p] = origin[p] + (corner[p] + at_p) * spacing[p]
    point[q] = origin[q] + (corner[q] + at_q) * spacing[q]
    return flat


@jit
def renumber_points(faces: I32, numbers: I64) -> None:
    """Put -1 - numbers[p] in place of each -1 - p, in place."""
    for f in range(faces.shape[0]):
        for c in range(3):
            if faces[f, c] < 0:
                faces[f, c] = -1 - numbers[-1 - faces[f, c]]


@jit
def number_points(faces: I32, first: int) -> None:
    """Put vertex number first + p in place of each -1 - p, in place."""
    for f in range(faces.shape[0]):
        for c in range(3):
            if faces[f, c] < 0:
                faces[f, c] = first + (-1 - faces[f, c])
