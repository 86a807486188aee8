"""Sharp rims: where the surface of a microstructure meets domain or skin, and sharp edges of the domain.

Marching cubes knows vertices on the edges of the grid only, so it cuts the corner wherever two surfaces meet inside a
cube. The polygon in which the surface passes through a cube runs on the faces of the cube, from one vertex to the next.
Where these two lie on different surfaces, the point of the face at which both surfaces vanish is put between them
(both cubes at the face find the same one, so the mesh stays closed), and the polygon is cut in two along the rim. Where
three surfaces meet, a polygon has more than two such points, or its two parts would cross, it becomes a fan around a
point within the cube.

Nothing crosses anything: the triangles of a cube meet its faces in the sides of its polygon only, and those do not
cross, as each face has one of them if it has a rim point. A fan around a point within a cube, whose boundary is convex,
does not cross itself. Where the surface passes through a cube in several polygons, these stay apart: each with its
rim points, and so with its triangles, lies on its side of planes known for each case of marching cubes, or does
without such a point. There is none either where the surface passes through a face twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sppm_pipeline.features.surface.numerics.placing import DOMAIN, FIELD, SKIN, Placed, Samples
from sppm_pipeline.features.surface.numerics.polygons import crossing, fans_from_ends, mean_slope, nearest_to_all
from sppm_pipeline.features.surface.numerics.rim_points import SHARP, Surfaces, edge_node, meeting_point
from sppm_pipeline.services.arrays import F64, I32, I64, U8, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN
from sppm_pipeline.services.mesh.marching_tables import separations

_CENTER = np.int64(1) << np.int64(62)
# of a polygon with its rim points: 12 edges of a cube, and as many points, twice, as pieces share the room
_MAX_CORNERS = 48


class Split(NamedTuple):
    """Triangles with sharp rims; numbers -1 - p in `faces` stand for points[p]."""

    faces: I32  # (m, 3)
    on: U8  # (m,), what each triangle lies on
    points: F64  # (n, 3)
    keys: I64  # (n,); points with equal keys are one: each cube at a face has its own
    # (k,), vertices beside rims beyond which a volume is lost, one for each point of a cube where that is so
    losers: I32
    lost: F64  # (k,), these volumes, voxels


class _Polygon(NamedTuple):
    """A polygon with its rim points, and the triangles it is cut into; rows of scratch."""

    ids: I64  # (n,), vertices, or -1 - p for points[p]
    masks: I64  # (n,), the faces of the cube on which each corner lies, as bits 2 * axis + side
    places: F64  # (n, 3)
    is_rim: Bools
    triangles: I64  # (n, 3), corners as rows of the others
    halves: U8  # (n,), what each triangle lies on


def split_rims(faces: I32, first: int, placed: Placed, samples: Samples) -> Split:
    """Cut triangles where they pass from one surface to another.

    `faces`, (m, 3), are those of marching cubes, cube by cube; `placed` has all of their vertices, the first of them
    numbered `first`, and `samples` all planes at their cubes.
    """
    grid, crossings = samples.grid, samples.crossings
    mixed = np.zeros(len(faces), np.bool_)
    n_mixed = _mixed(faces, first, placed.on, placed.triangle, crossings.normals, mixed)
    room = len(faces) + 12 * n_mixed
    out = Split(
        np.empty((room, 3), np.int32), np.empty(room, np.uint8), np.empty((6 * n_mixed, 3)),
        np.empty(6 * n_mixed, np.int64), np.empty(6 * n_mixed, np.int32), np.empty(6 * n_mixed),
    )  # fmt: skip
    surfaces = Surfaces(
        samples.field, samples.domain, samples.skin, np.array(grid.origin), np.array(grid.spacing),
        np.array([*grid.shape, samples.start]), crossings.edge, crossings.share, crossings.triangle,
        crossings.normals, separations(),
    )  # fmt: skip
    polygon = _Polygon(
        np.empty(_MAX_CORNERS, np.int64), np.empty(_MAX_CORNERS, np.int64), np.empty((_MAX_CORNERS, 3)),
        np.empty(_MAX_CORNERS, np.bool_), np.empty((_MAX_CORNERS, 3), np.int64), np.empty(_MAX_CORNERS, np.uint8),
    )  # fmt: skip
    m, n, k = _split(faces, mixed, first, placed, surfaces, polygon, out)
    # copies of the short ones, so that the room for the most there could be is freed
    points, keys, losers, lost = out.points[:n].copy(), out.keys[:n].copy(), out.losers[:k].copy(), out.lost[:k].copy()
    return Split(out.faces[:m], out.on[:m], points, keys, losers, lost)


@jit
def _mixed(faces: I32, first: int, on: U8, triangle: I32, normals: F64, mixed: Bools) -> int:
    """Mark the triangles whose corners lie on surfaces that meet at an edge; returns their number."""
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
def _cube(faces: I32, f: int, first: int, edge: I64, nx: int, ny: int, node: I64, cube: I64) -> None:
    """Low corner of the cube of a triangle, whose three grid edges always span it."""
    for c in range(3):
        edge_node(edge[faces[f, c] - first], nx, ny, node)
        for a in range(3):
            cube[a] = node[a] if c == 0 else min(cube[a], node[a])


@jit
def _copied(faces: I32, start: int, stop: int, first: int, on: U8, out: Split, m: int) -> int:
    """Write triangles as they are from place m on; those with a corner on the domain belong to it."""
    for t in range(start, stop):
        out.on[m] = on[faces[t, 0] - first]
        for c in range(3):
            out.faces[m, c] = faces[t, c]
            if on[faces[t, c] - first] == DOMAIN:
                out.on[m] = DOMAIN
        m += 1
    return m


@jit
def _outline(faces: I32, f: int, stop: int, starts: I32, ends: I32) -> int:
    """Edges of triangles of a cube that have no partner, which are those of its polygons; returns their number."""
    count = int(np.int64(0))
    for t in range(f, stop):
        for c in range(3):
            tail, head = faces[t, c], faces[t, (c + 1) % 3]
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
def _cut_in_two(polygon: _Polygon, size: int, rims: int, on: U8, first: int) -> int:
    """Cut a polygon with one or two rim points along the rim; returns the number of triangles, 0 if it can't be.

    The cut is the line from one point to the other; with a single point nothing is cut.
    """
    part = np.empty(_MAX_CORNERS, np.int64)
    one, two = -1, -1
    for s in range(size):
        if polygon.is_rim[s]:
            if one < 0:
                one = s
            two = s
    # two rim points on one face of the cube: a cut between them would lie in that face
    if one != two and polygon.masks[one] & polygon.masks[two]:
        return 0
    made = int(np.int64(0))
    for half in range(rims):
        s = one if half == 0 else two
        end = (one if half else two) if rims == 2 else (one + size - 1) % size
        # the corners from one rim point to the other (or, with one rim point, once around)
        length = 0
        while True:
            part[length] = s
            length += 1
            if s == end:
                break
            s = (s + 1) % size
        before = made
        made = fans_from_ends(part, length, rims == 1, polygon.places, polygon.masks, made, polygon.triangles)
        if made == before:
            return 0
        for t in range(before, made):
            polygon.halves[t] = on[polygon.ids[part[1]] - first]
    return 0 if crossing(polygon.triangles, made, polygon.places) else made


@jit
def _move_to_corner(
    polygon: _Polygon, size: int, cube: I64, first: int, placed: Placed, surfaces: Surfaces, point: F64
) -> None:
    """Move the middle of a polygon to where its surfaces meet, if the domain has a sharp edge there.

    Elsewhere the middle of the rim points is on the rims, and within the domain.
    """
    on, triangle, normals, spacing = placed.on, placed.triangle, surfaces.normals, surfaces.spacing
    plane_points, plane_normals = np.empty((_MAX_CORNERS, 3)), np.empty((_MAX_CORNERS, 3))
    planes = int(np.int64(0))
    sharp, one_of = False, np.int32(-1)
    i, j, k = cube[0], cube[1], cube[2] - surfaces.shape[3]
    for s in range(size):
        if polygon.is_rim[s]:
            continue
        v = polygon.ids[s] - first
        length2 = 0.0
        if on[v] == DOMAIN and triangle[v] >= 0:
            one_of = triangle[v] if one_of < 0 else one_of
            p, q = normals[one_of], normals[triangle[v]]
            sharp |= p[0] * q[0] + p[1] * q[1] + p[2] * q[2] < SHARP
            for a in range(3):
                plane_normals[planes, a] = q[a]
            length2 = 1.0
        else:
            values = surfaces.field if on[v] == FIELD else (surfaces.skin if on[v] == SKIN else surfaces.domain)
            for a in range(3):
                plane_normals[planes, a] = mean_slope(values, i, j, k, a) / spacing[a]
                length2 += plane_normals[planes, a] ** 2
        if length2 > 0.0:
            for a in range(3):
                plane_normals[planes, a] /= math.sqrt(length2)
                plane_points[planes, a] = polygon.places[s, a]
            planes += 1
    if sharp:
        nearest_to_all(planes, plane_points, plane_normals, point, spacing)


@jit
def _split(
    faces: I32, mixed: Bools, first: int, placed: Placed, surfaces: Surfaces, polygon: _Polygon, out: Split
) -> tuple[int, int, int]:
    """Write the triangles, rim points and losses, and return their numbers."""
    edge, on = placed.edge, placed.on
    origin, spacing, nx, ny = surfaces.origin, surfaces.spacing, surfaces.shape[0], surfaces.shape[1]
    ids, places, is_rim = polygon.ids, polygon.places, polygon.is_rim
    m = int(np.int64(0))
    n = int(np.int64(0))
    losses = int(np.int64(0))
    node, corner, cube, point = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64), np.empty(4)
    starts, ends = np.empty(64, np.int32), np.empty(64, np.int32)
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
        m = _copied(faces, f, begun, first, on, out, m)
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
        count = _outline(faces, f, stop, starts, ends)
        polygons = 0
        while count > 0:
            polygons += 1
            # begin with the smallest vertex, so that nothing depends on the order of the edges
            begin = starts[0]
            for e in range(count):
                begin = min(begin, starts[e])
            here = begin
            size, rims = 0, 0
            while True:
                e = 0
                while starts[e] != here:
                    e += 1
                following = ends[e]
                count -= 1
                starts[e], ends[e] = starts[count], ends[count]
                # the vertex, and the two faces on which its grid edge lies
                axis = edge_node(edge[here - first], nx, ny, node)
                mask = 0
                for a in range(3):
                    places[size, a] = placed.vertices[here - first, a]
                    if a != axis:
                        mask |= 1 << (2 * a + int(node[a] > cube[a]))
                ids[size], polygon.masks[size], is_rim[size] = here, mask, False
                size += 1
                flat = meeting_point(here - first, following - first, cube, placed, surfaces, point)
                if flat >= 0:
                    ids[size], is_rim[size] = -1 - n, True
                    polygon.masks[size] = 1 << (2 * flat + int(node[flat] > cube[flat]))
                    out.keys[n] = np.int64(min(here, following)) << 31 | np.int64(max(here, following))
                    for a in range(3):
                        places[size, a] = point[a]
                        out.points[n, a] = point[a]
                    if point[3] > 0.0:
                        out.losers[losses] = here if on[here - first] == FIELD else following
                        out.lost[losses] = 0.5 * point[3]  # the cube at the other side of the face has the same
                        losses += 1
                    size += 1
                    rims += 1
                    n += 1
                here = following
                if here == begin:
                    break
            if rims == 0:
                for t in range(f, stop):
                    for s in range(size):
                        if ids[s] == faces[t, 0]:
                            m = _copied(faces, t, t + 1, first, on, out, m)
                continue
            made = _cut_in_two(polygon, size, rims, on, first) if rims <= 2 else 0
            for t in range(made):
                for c in range(3):
                    out.faces[m, c] = ids[polygon.triangles[t, c]]
                out.on[m] = polygon.halves[t]
                m += 1
            if made > 0:
                continue
            # a fan around a point within the cube, which looks from there like its faces: nothing crosses
            for a in range(3):
                point[a] = 0.0
                for s in range(size):
                    if is_rim[s]:
                        point[a] += places[s, a] / rims
            if polygons == 1 and count == 0:  # several polygons are apart with the middles of their points only
                _move_to_corner(polygon, size, cube, first, placed, surfaces, point)
            for a in range(3):
                least = origin[a] + (cube[a] + EDGE_MARGIN) * spacing[a]
                most = origin[a] + (cube[a] + 1.0 - EDGE_MARGIN) * spacing[a]
                point[a] = min(max(point[a], least), most)
                out.points[n, a] = point[a]
            # a cube has up to four polygons
            out.keys[n] = _CENTER + 4 * ((cube[2] * ny + cube[1]) * nx + cube[0]) + polygons - 1
            center = -1 - n
            n += 1
            for s in range(size):
                t = (s + 1) % size
                out.faces[m, 0], out.faces[m, 1], out.faces[m, 2] = center, ids[s], ids[t]
                out.on[m] = on[(ids[t] if is_rim[s] else ids[s]) - first]
                m += 1
        f = stop
    return m, n, losses
