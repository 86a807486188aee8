"""Sharp rims: where the surface of a microstructure meets domain or skin, and sharp edges of the domain.

Marching cubes knows vertices on the edges of the grid only, so it cuts the corner wherever two surfaces meet inside a
cube. The polygon in which the surface passes through a cube runs on the faces of the cube, from one vertex to the next.
Where these two lie on different surfaces, the point of the face at which both surfaces vanish is put between them
(both cubes at the face find the same one, so the mesh stays closed), and the polygon is cut in two along the rim. Where
three surfaces meet, a polygon has more than two such points, or its two parts would cross, it becomes a fan around a
point within the cube.

Nothing crosses anything: the triangles of a cube meet its faces in the sides of its polygon only, and those do not
cross, as each face has one of them if it has a rim point. A fan around a point within a cube, whose boundary is convex,
does not cross itself. Where the surface passes through a cube in several polygons, or through a face twice, triangles
stay as they are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN
from sppm_pipeline.numerics.surface.marching_tables import polygon_counts
from sppm_pipeline.numerics.surface.placing import DOMAIN, FIELD, SKIN, Placed, Samples
from sppm_pipeline.numerics.surface.polygons import crossing, fans_from_ends, nearest_to_all
from sppm_pipeline.numerics.surface.rim_points import SHARP, edge_node, loops_of_cube, meeting_point

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
        polygon_counts(),
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
        edge_node(edge[faces[f, c] - first], nx, ny, node)
        for a in range(3):
            cube[a] = node[a] if c == 0 else min(cube[a], node[a])


@jit
def _copied(
    faces: NDArray[np.int32],
    start: int,
    stop: int,
    first: int,
    on: NDArray[np.uint8],
    out: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    m: int,
) -> int:
    """Write triangles as they are from place m on; those with a corner on the domain belong to it."""
    for t in range(start, stop):
        kinds[m] = on[faces[t, 0] - first]
        for c in range(3):
            out[m, c] = faces[t, c]
            if on[faces[t, c] - first] == DOMAIN:
                kinds[m] = DOMAIN
        m += 1
    return m


@jit
def _sides(
    faces: NDArray[np.int32],
    f: int,
    stop: int,
    first: int,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> int:
    """Write the edges of some triangles that have no partner among them, and return their number."""
    count = int(np.int64(0))
    for t in range(f, stop):
        for c in range(3):
            tail, head = np.int64(faces[t, c]) - first, np.int64(faces[t, (c + 1) % 3]) - first
            partner = -1
            for e in range(count):
                if starts[e] == head and ends[e] == tail:
                    partner = e
                    break
            if partner >= 0:
                count -= 1
                starts[partner], ends[partner] = starts[count], ends[count]
            else:
                starts[count], ends[count] = tail, head
                count += 1
    return count


@jit
def _two_parts(
    size: int,
    rims: int,
    first: int,
    ids: NDArray[np.int64],
    masks: NDArray[np.int64],
    is_rim: NDArray[np.bool_],
    places: NDArray[np.float64],
    on: NDArray[np.uint8],
    part: NDArray[np.int64],
    halves: NDArray[np.uint8],
    triangles: NDArray[np.int64],
) -> int:
    """Cut a polygon in two along its rim points; return the number of triangles, 0 if it can't be cut so."""
    made = int(np.int64(0))  # a literal would have what is called with it compiled anew
    if rims > 2:
        return made
    # two parts along the line from one point to the other; with a single point nothing is cut
    one, two = -1, -1
    for s in range(size):
        if is_rim[s]:
            if one < 0:
                one = s
            two = s
    if one == two or not masks[one] & masks[two]:
        for half in range(rims):
            s = one if half == 0 else two
            end = (one if half else two) if rims == 2 else (one + size - 1) % size
            length = 0
            while True:
                part[length] = s
                length += 1
                if s == end:
                    break
                s = (s + 1) % size
            before = made
            made = fans_from_ends(part, length, rims == 1, places, masks, made, triangles)
            if made == before:
                return 0
            for t in range(before, made):
                halves[t] = on[ids[part[1]] - first]
        if crossing(triangles, made, places):
            return 0
    return made


@jit
def _middle(
    size: int,
    rims: int,
    first: int,
    ids: NDArray[np.int64],
    is_rim: NDArray[np.bool_],
    places: NDArray[np.float64],
    on: NDArray[np.uint8],
    triangle: NDArray[np.int32],
    normals: NDArray[np.float64],
    field: NDArray[np.float32],
    domain: NDArray[np.float32],
    skin: NDArray[np.float32],
    cube: NDArray[np.int64],
    spacing: NDArray[np.float64],
    start: int,
    plane_points: NDArray[np.float64],
    plane_normals: NDArray[np.float64],
    point: NDArray[np.float64],
) -> None:
    """The middle of the rim points of a polygon, or the corner that is nearest to the planes of its vertices."""
    for a in range(3):
        point[a] = 0.0
        for s in range(size):
            if is_rim[s]:
                point[a] += places[s, a] / rims
    planes = int(np.int64(0))
    corner_there, one_of = False, np.int32(-1)
    for s in range(size):
        if is_rim[s]:
            continue
        v = ids[s] - first
        if on[v] == DOMAIN and triangle[v] >= 0:
            for a in range(3):
                plane_points[planes, a] = places[s, a]
                plane_normals[planes, a] = normals[triangle[v], a]
            one_of = triangle[v] if one_of < 0 else one_of
            p, q = normals[one_of], normals[triangle[v]]
            corner_there |= p[0] * q[0] + p[1] * q[1] + p[2] * q[2] < SHARP
            planes += 1
        else:
            values = field if on[v] == FIELD else (skin if on[v] == SKIN else domain)
            length2 = 0.0
            for a in range(3):
                i, j, k = cube[0], cube[1], cube[2] - start
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
    if corner_there:  # elsewhere the middle of the points is on the rims, and within the domain
        nearest_to_all(planes, plane_points, plane_normals, point, spacing)


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
    loops: NDArray[np.int64],
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
    part, halves, triangles = np.empty(_MOST, np.int64), np.empty(_MOST, np.uint8), np.empty((_MOST, 3), np.int64)
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
        m = _copied(faces, f, begun, first, on, out, kinds, m)
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
        if loops_of_cube(cube, field, domain, skin, shape, loops) > 1:
            m = _copied(faces, f, stop, first, on, out, kinds, m)
            f = stop
            continue
        # the polygon: edges of triangles that have no partner
        count = _sides(faces, f, stop, first, starts, ends)
        # begin with the smallest vertex, so that nothing depends on the order above
        here = starts[0]
        for e in range(count):
            here = min(here, starts[e])
        size, rims = int(np.int64(0)), int(np.int64(0))
        while count > 0:
            e = 0
            while starts[e] != here:
                e += 1
            following = ends[e]
            count -= 1
            starts[e], ends[e] = starts[count], ends[count]
            # the vertex, and the two faces on which its grid edge lies
            axis = edge_node(edge[here], nx, ny, node)
            mask = 0
            for a in range(3):
                places[size, a] = vertices[here, a]
                if a != axis:
                    mask |= 1 << (2 * a + int(node[a] > cube[a]))
            ids[size], masks[size], is_rim[size] = here + first, mask, False
            size += 1
            flat = meeting_point(
                here, following, cube, vertices, edge, on, triangle, field, domain, skin,
                origin, spacing, shape, crossed, shares, owners, normals, loops, point,
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
        if rims == 0:
            m = _copied(faces, f, stop, first, on, out, kinds, m)
            f = stop
            continue
        made = _two_parts(size, rims, first, ids, masks, is_rim, places, on, part, halves, triangles)
        for t in range(made):
            for c in range(3):
                out[m, c] = ids[triangles[t, c]]
            kinds[m] = halves[t]
            m += 1
        if made == 0:
            # a fan around a point within the cube, which looks from there like its faces: nothing crosses
            _middle(
                size, rims, first, ids, is_rim, places, on, triangle, normals, field, domain, skin, cube, spacing,
                shape[3], plane_points, plane_normals, point,
            )  # fmt: skip
            for a in range(3):
                least = origin[a] + (cube[a] + EDGE_MARGIN) * spacing[a]
                most = origin[a] + (cube[a] + 1.0 - EDGE_MARGIN) * spacing[a]
                point[a] = min(max(point[a], least), most)
                points[n, a] = point[a]
            keys[n] = _CENTER + (cube[2] * ny + cube[1]) * nx + cube[0]
            center = -1 - (numbered + n)
            n += 1
            for s in range(size):
                t = (s + 1) % size
                out[m, 0], out[m, 1], out[m, 2] = center, ids[s], ids[t]
                kinds[m] = on[(ids[t] if is_rim[s] else ids[s]) - first]
                m += 1
        f = stop
    return m, n
