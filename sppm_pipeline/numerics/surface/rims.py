"""Sharp rims: where the surface of a microstructure meets domain or skin, and sharp edges of the domain.

Marching cubes knows vertices on the edges of the grid only, so it cuts the corner wherever two surfaces meet inside a
cube. The polygon in which the surface passes through a cube runs on the faces of the cube, from one vertex to the next.
Where these two lie on different surfaces, the point of the face at which both surfaces vanish is put between them
(both cubes at the face find the same one, so the mesh stays closed), and the polygon is cut in two along the rim. Where
three surfaces meet, or a polygon has more than two such points, it becomes a fan around the point nearest to all of its
surfaces.

In a face the domain is the line between the two places where its triangles pierce the sides of the face, and the other
field is followed along this line by a bicubic polynomial: its zero exists by its signs, however tangent the surfaces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN
from sppm_pipeline.numerics.surface.placing import DOMAIN, FIELD, SKIN, Placed, Samples, cubic, sample_line

SHARP = math.cos(math.radians(25.0))
"""Triangles of the domain whose normals differ by more meet in a sharp edge; a choice."""

_CENTER = np.int64(1) << np.int64(62)
_MOST = 48  # vertices of a polygon with its rim points: 12 edges of a cube, and as many points; pieces share the room


class Split(NamedTuple):
    """Triangles with sharp rims.

    Attributes
    ----------
    faces : (m, 3) int32
        Negative numbers -1 - p stand for points[p].
    on : (m,) uint8
        What each triangle lies on.
    points : (n, 3) float64
    keys : (n,) int64
        Points with equal keys are one: each cube at a face has its own.
    """

    faces: NDArray[np.int32]
    on: NDArray[np.uint8]
    points: NDArray[np.float64]
    keys: NDArray[np.int64]


def split_rims(faces: NDArray[np.int32], first: int, placed: Placed, samples: Samples, numbered: int) -> Split:
    """Cut triangles where they pass from one surface to another.

    Parameters
    ----------
    faces : (m, 3) int32
        Of marching cubes, cube by cube.
    first : int
        Number of the vertex that is the first one in `placed`.
    placed : Placed
        All vertices of these faces.
    samples : Samples
        All planes at the cubes of these faces.
    numbered : int
        How many points there are already.
    """
    grid, crossings = samples.grid, samples.crossings
    mixed = np.zeros(len(faces), np.bool_)
    n_mixed = _mixed(faces, first, placed.on, placed.triangle, crossings.normals, mixed)
    out = np.empty((len(faces) + 12 * n_mixed, 3), np.int32)
    on = np.empty(len(out), np.uint8)
    points, keys = np.empty((6 * n_mixed, 3)), np.empty(6 * n_mixed, np.int64)
    m, n = _split(
        faces,
        mixed,
        first,
        numbered,
        *placed,
        samples.field,
        samples.domain,
        samples.skin,
        np.array(grid.origin),
        np.array(grid.spacing),
        np.array([*grid.shape, samples.start]),
        crossings.edge,
        crossings.share,
        crossings.triangle,
        crossings.normals,
        out,
        on,
        points,
        keys,
    )
    return Split(out[:m], on[:m], points[:n].copy(), keys[:n].copy())


@jit
def _mixed(
    faces: NDArray[np.int32],
    first: int,
    on: NDArray[np.uint8],
    triangle: NDArray[np.int32],
    normals: NDArray[np.float64],
    mixed: NDArray[np.bool_],
) -> int:
    """Mark the triangles whose corners lie on surfaces that meet at an edge, and return how many they are."""
    n = 0
    for f in range(faces.shape[0]):
        found = False
        for c in range(3):
            v, w = faces[f, c] - first, faces[f, (c + 1) % 3] - first
            if on[v] != on[w]:
                found = True
            elif on[v] == DOMAIN and triangle[v] != triangle[w] and triangle[v] >= 0 and triangle[w] >= 0:
                p, q = normals[triangle[v]], normals[triangle[w]]
                found |= p[0] * q[0] + p[1] * q[1] + p[2] * q[2] < SHARP
        mixed[f] = found
        n += found
    return n


@jit
def _cube(
    faces: NDArray[np.int32],
    f: int,
    first: int,
    edge: NDArray[np.int64],
    nx: int,
    ny: int,
    node: NDArray[np.int64],
    cube: NDArray[np.int64],
) -> None:
    """Low corner of the cube of a triangle, whose three grid edges always span it."""
    for c in range(3):
        _nodes(edge[faces[f, c] - first], nx, ny, node)
        for a in range(3):
            cube[a] = node[a] if c == 0 else min(cube[a], node[a])


@jit
def _patch(
    values: NDArray[np.float32],
    k: int,
    j: int,
    i: int,
    b: int,
    c: int,
    patch: NDArray[np.float64],
) -> None:
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
def _bicubic(patch: NDArray[np.float64], u: float, v: float) -> float:
    """Value at a place (u, v) in the middle of a patch, by the bicubic through its samples."""
    rows = (
        cubic(patch[0, 0], patch[0, 1], patch[0, 2], patch[0, 3], u),
        cubic(patch[1, 0], patch[1, 1], patch[1, 2], patch[1, 3], u),
        cubic(patch[2, 0], patch[2, 1], patch[2, 2], patch[2, 3], u),
        cubic(patch[3, 0], patch[3, 1], patch[3, 2], patch[3, 3], u),
    )
    return cubic(rows[0], rows[1], rows[2], rows[3], v)


@jit
def _nodes(edge: int, nx: int, ny: int, node: NDArray[np.int64]) -> int:
    """The node at which a grid edge begins, into `node`, and its axis."""
    place = edge // 3
    node[0], node[1], node[2] = place % nx, place // nx % ny, place // nx // ny
    return int(edge % 3)


@jit
def _meeting(
    a: int,
    b: int,
    vertices: NDArray[np.float64],
    edge: NDArray[np.int64],
    on: NDArray[np.uint8],
    triangle: NDArray[np.int32],
    field: NDArray[np.float32],
    domain: NDArray[np.float32],
    skin: NDArray[np.float32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    shape: NDArray[np.int64],
    crossed: NDArray[np.int64],
    shares: NDArray[np.float64],
    owners: NDArray[np.int32],
    normals: NDArray[np.float64],
    point: NDArray[np.float64],
) -> int:
    """The point at which the surfaces of two vertices on one face of a cube meet, and that face; -1 if they do not.

    Faces are numbered 2 * axis + side within their cube; here the side is left out.
    """
    if on[a] == on[b] and on[a] != DOMAIN:
        return -1
    if on[a] != FIELD and on[b] != FIELD and on[a] != on[b]:
        return -1  # skin and domain are parallel
    na, nb = np.empty(3, np.int64), np.empty(3, np.int64)
    axis_a, axis_b = _nodes(edge[a], shape[0], shape[1], na), _nodes(edge[b], shape[0], shape[1], nb)
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
        if abs(det) < 1e-3 * math.sqrt((mp * mp + mq * mq) * (np_ * np_ + nq * nq)):
            return -1
        first, second = mp * up + mq * uq, np_ * vp + nq * vq
        at_p, at_q = (first * nq - mq * second) / det, (mp * second - first * np_) / det
        if min(at_p, at_q) < -0.5 or max(at_p, at_q) > 1.5:
            return -1
    else:
        other = b if on[a] == FIELD else a
        sp, sq = (vp, vq) if other == b else (up, uq)  # the line begins here, on domain or skin
        flat_values = domain if on[other] == DOMAIN else skin
        node = np.empty(3, np.int64)
        patch = np.empty((4, 4))
        _patch(field, corner[2] - shape[3], corner[1], corner[0], p, q, patch)
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
                    r = np.searchsorted(crossed, key)
                    while r < crossed.size and crossed[r] == key:
                        m, n = normals[triangle[other]], normals[owners[r]]
                        if m[0] * n[0] + m[1] * n[1] + m[2] * n[2] >= SHARP:
                            share = shares[r]
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
                continue
            low, high, f_low, f_high = 0.0, 1.0, at_start, at_end
            t = 0.5
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
            at_p, at_q = sp + t * (ep - sp), sq + t * (eq - sq)
            break
        if not found and not best < np.inf:
            at_p, at_q = 0.5 * (up + vp), 0.5 * (uq + vq)
    at_p = min(max(at_p, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
    at_q = min(max(at_q, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
    point[flat] = origin[flat] + corner[flat] * spacing[flat]
    point[p] = origin[p] + (corner[p] + at_p) * spacing[p]
    point[q] = origin[q] + (corner[q] + at_q) * spacing[q]
    return flat


@jit
def _area(a: NDArray[np.float64], b: NDArray[np.float64], c: NDArray[np.float64]) -> float:
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(x * x + y * y + z * z)


@jit
def _triangulate(
    count: int,
    places: NDArray[np.float64],
    masks: NDArray[np.int64],
    cost: NDArray[np.float64],
    middle: NDArray[np.int64],
    stack: NDArray[np.int64],
    triangles: NDArray[np.int64],
) -> int:
    """Triangles of least area of a polygon, none with a diagonal in a face of the cube; 0 if there are none such."""
    for width in range(1, count):
        for i in range(count - width):
            j = i + width
            if width == 1:
                cost[i, j] = 0.0
                continue
            cost[i, j] = np.inf
            if width < count - 1 and masks[i] & masks[j]:
                continue
            for k in range(i + 1, j):
                total = cost[i, k] + cost[k, j] + _area(places[i], places[k], places[j])
                if total < cost[i, j]:
                    cost[i, j] = total
                    middle[i, j] = k
    if not cost[0, count - 1] < np.inf:
        return 0
    n, left = 0, 1
    stack[0, 0], stack[0, 1] = 0, count - 1
    while left:
        left -= 1
        i, j = stack[left, 0], stack[left, 1]
        if j - i < 2:
            continue
        k = middle[i, j]
        triangles[n, 0], triangles[n, 1], triangles[n, 2] = i, k, j
        n += 1
        stack[left, 0], stack[left, 1] = i, k
        stack[left + 1, 0], stack[left + 1, 1] = k, j
        left += 2
    return n


@jit
def _nearest_to_all(
    count: int,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    middle: NDArray[np.float64],
    spacing: NDArray[np.float64],
) -> None:
    """Move `middle` to the point nearest to some planes, in the sense of least squares (Kobbelt et al. 2001)."""
    matrix, right = np.zeros((3, 3)), np.zeros(3)
    for r in range(count):
        off = 0.0
        for a in range(3):
            off += normals[r, a] * (points[r, a] - middle[a])
        for a in range(3):
            right[a] += normals[r, a] * off
            for b in range(3):
                matrix[a, b] += normals[r, a] * normals[r, b]
    for a in range(3):
        matrix[a, a] += 1e-3
    # Cramer's rule; the matrix is positive definite
    m = matrix
    det = (
        m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
        - m[0, 1] * (m[1, 0] * m[2, 2] - m[1, 2] * m[2, 0])
        + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
    )
    x = np.empty(3)
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        # the inverse of a symmetric matrix, row by row
        x[a] = (
            right[a] * (m[b, b] * m[c, c] - m[b, c] * m[c, b])
            + right[b] * (m[c, b] * m[a, c] - m[a, b] * m[c, c])
            + right[c] * (m[a, b] * m[b, c] - m[b, b] * m[a, c])
        ) / det
    for a in range(3):
        middle[a] += x[a]


@jit
def _split(
    faces: NDArray[np.int32],
    mixed: NDArray[np.bool_],
    first: int,
    numbered: int,
    vertices: NDArray[np.float64],
    edge: NDArray[np.int64],
    on: NDArray[np.uint8],
    triangle: NDArray[np.int32],
    field: NDArray[np.float32],
    domain: NDArray[np.float32],
    skin: NDArray[np.float32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    shape: NDArray[np.int64],
    crossed: NDArray[np.int64],
    shares: NDArray[np.float64],
    owners: NDArray[np.int32],
    normals: NDArray[np.float64],
    out: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    points: NDArray[np.float64],
    keys: NDArray[np.int64],
) -> tuple[int, int]:
    """Write the triangles and rim points, and return their numbers."""
    nx, ny = shape[0], shape[1]
    m = int(np.int64(0))
    n = int(np.int64(0))
    node, corner, cube = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    starts, ends = np.empty(64, np.int64), np.empty(64, np.int64)
    ids, masks = np.empty(_MOST, np.int64), np.empty(_MOST, np.int64)
    places, point = np.empty((_MOST, 3)), np.empty(3)
    is_rim = np.empty(_MOST, np.bool_)
    part_ids, part_masks, part_places = np.empty(_MOST, np.int64), np.empty(_MOST, np.int64), np.empty((_MOST, 3))
    cost, middle = np.empty((_MOST, _MOST)), np.empty((_MOST, _MOST), np.int64)
    stack, made = np.empty((_MOST, 2), np.int64), np.empty((_MOST, 3), np.int64)
    plane_points, plane_normals = np.empty((_MOST, 3)), np.empty((_MOST, 3))
    f = int(np.int64(0))
    following_mixed = int(np.int64(0))
    while f < faces.shape[0]:
        # triangles are copied up to the cube of the next mixed one; those of a cube follow each other
        while following_mixed < faces.shape[0] and not mixed[following_mixed]:
            following_mixed += 1
        begun = following_mixed
        if begun < faces.shape[0]:
            _cube(faces, begun, first, edge, nx, ny, node, cube)
            while begun > f:
                _cube(faces, begun - 1, first, edge, nx, ny, node, corner)
                if corner[0] != cube[0] or corner[1] != cube[1] or corner[2] != cube[2]:
                    break
                begun -= 1
        for t in range(f, begun):
            for c in range(3):
                out[m, c] = faces[t, c]
            kinds[m] = on[faces[t, 0] - first]
            m += 1
        f = begun
        if f == faces.shape[0]:
            break
        stop = following_mixed + 1
        while stop < faces.shape[0]:
            _cube(faces, stop, first, edge, nx, ny, node, corner)
            if corner[0] != cube[0] or corner[1] != cube[1] or corner[2] != cube[2]:
                break
            stop += 1
        following_mixed = stop
        # the polygons: edges of triangles that have no partner
        count = 0
        for t in range(f, stop):
            for c in range(3):
                a, b = np.int64(faces[t, c]) - first, np.int64(faces[t, (c + 1) % 3]) - first
                partner = -1
                for e in range(count):
                    if starts[e] == b and ends[e] == a:
                        partner = e
                        break
                if partner >= 0:
                    count -= 1
                    starts[partner], ends[partner] = starts[count], ends[count]
                else:
                    starts[count], ends[count] = a, b
                    count += 1
        loop_number = 0
        while count > 0:
            # begin with the smallest vertex, so that nothing depends on the order above
            here = starts[0]
            for e in range(count):
                here = min(here, starts[e])
            begin = here
            size, rims = 0, 0
            while True:
                e = 0
                while starts[e] != here:
                    e += 1
                following = ends[e]
                count -= 1
                starts[e], ends[e] = starts[count], ends[count]
                # the vertex, and the two faces on which its grid edge lies
                axis = _nodes(edge[here], nx, ny, node)
                mask = 0
                for a in range(3):
                    places[size, a] = vertices[here, a]
                    if a != axis:
                        mask |= 1 << (2 * a + int(node[a] > cube[a]))
                ids[size], masks[size], is_rim[size] = here + first, mask, False
                size += 1
                flat = _meeting(
                    here, following, vertices, edge, on, triangle, field, domain, skin,
                    origin, spacing, shape, crossed, shares, owners, normals, point,
                )  # fmt: skip
                if flat >= 0:
                    low, high = min(here, following) + first, max(here, following) + first
                    ids[size], is_rim[size] = -1 - (numbered + n), True
                    masks[size] = 1 << (2 * flat + int(node[flat] > cube[flat]))
                    keys[n] = low << 31 | high
                    for a in range(3):
                        places[size, a] = point[a]
                        points[n, a] = point[a]
                    size += 1
                    rims += 1
                    n += 1
                here = following
                if here == begin:
                    break
            if rims == 0:
                # one surface: the triangles as they were, those of this polygon
                for t in range(f, stop):
                    own = False
                    for s in range(size):
                        own |= ids[s] == faces[t, 0]
                    if own:
                        for c in range(3):
                            out[m, c] = faces[t, c]
                        kinds[m] = on[faces[t, 0] - first]
                        m += 1
                loop_number += 1
                continue
            done = False
            if rims <= 2:
                # two parts along the line from one point to the other; with a single point nothing is cut
                one, two = -1, -1
                for s in range(size):
                    if is_rim[s]:
                        if one < 0:
                            one = s
                        two = s
                if one == two or not masks[one] & masks[two]:
                    done = True
                    mark = m
                    for half in range(rims):
                        s = one if half == 0 else two
                        end = (one if half else two) if rims == 2 else (one + size - 1) % size
                        length = 0
                        while True:
                            part_ids[length], part_masks[length] = ids[s], masks[s]
                            for a in range(3):
                                part_places[length, a] = places[s, a]
                            length += 1
                            if s == end:
                                break
                            s = (s + 1) % size
                        found = _triangulate(length, part_places, part_masks, cost, middle, stack, made)
                        if found == 0:
                            done = False
                            m = mark
                            break
                        for t in range(found):
                            for c in range(3):
                                out[m, c] = part_ids[made[t, c]]
                            kinds[m] = on[part_ids[1] - first]
                            m += 1
            if not done:
                for a in range(3):
                    point[a] = 0.0
                    for s in range(size):
                        if is_rim[s]:
                            point[a] += places[s, a] / rims
                planes = 0
                for s in range(size):
                    if is_rim[s]:
                        continue
                    v = ids[s] - first
                    if on[v] == DOMAIN and triangle[v] >= 0:
                        for a in range(3):
                            plane_points[planes, a] = places[s, a]
                            plane_normals[planes, a] = normals[triangle[v], a]
                        planes += 1
                    else:
                        values = field if on[v] == FIELD else (skin if on[v] == SKIN else domain)
                        length2 = 0.0
                        for a in range(3):
                            i, j, k = cube[0], cube[1], cube[2] - shape[3]
                            slope = 0.0
                            for c in range(4):
                                e, g = c & 1, c >> 1
                                if a == 0:
                                    slope += np.float64(values[k + g, j + e, i + 1]) - values[k + g, j + e, i]
                                elif a == 1:
                                    slope += np.float64(values[k + g, j + 1, i + e]) - values[k + g, j, i + e]
                                else:
                                    slope += np.float64(values[k + 1, j + g, i + e]) - values[k, j + g, i + e]
                            plane_normals[planes, a] = slope / spacing[a]
                            plane_points[planes, a] = places[s, a]
                            length2 += (slope / spacing[a]) ** 2
                        if length2 > 0.0:
                            for a in range(3):
                                plane_normals[planes, a] /= math.sqrt(length2)
                            planes += 1
                _nearest_to_all(planes, plane_points, plane_normals, point, spacing)
                for a in range(3):
                    least = origin[a] + (cube[a] + EDGE_MARGIN) * spacing[a]
                    most = origin[a] + (cube[a] + 1.0 - EDGE_MARGIN) * spacing[a]
                    point[a] = min(max(point[a], least), most)
                    points[n, a] = point[a]
                keys[n] = _CENTER + 16 * ((cube[2] * ny + cube[1]) * nx + cube[0]) + loop_number
                center = -1 - (numbered + n)
                n += 1
                for s in range(size):
                    t = (s + 1) % size
                    out[m, 0], out[m, 1], out[m, 2] = center, ids[s], ids[t]
                    kinds[m] = on[(ids[t] if is_rim[s] else ids[s]) - first]
                    m += 1
            loop_number += 1
        f = stop
    return m, n
