"""Flat triangles on a curved surface: moved outwards by what they cut off.

A mesh whose vertices all lie on a curved surface is too thin where the solid is convex and too thick where it is
concave, by a volume that falls with the square of the spacing only. Over an edge the surface rises by ``s^2 k / 8``,
with the length s and the curvature k, which is the turn of the normals along the edge over its length; a parabolic
patch rises over a triangle by a third of the sum of its three edges on average. Every vertex is moved by the
mean rise of its triangles, so that the mesh encloses what the surface does: along its edge of the grid, not its normal,
so that the surface in a cube stays in it and runs into no other sheet nearby.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.surface.marching_cubes import EDGE_MARGIN
from sppm_pipeline.numerics.surface.placing import DOMAIN

MOST = 0.3
"""Vertices are moved by at most this fraction of their shortest edge; a choice that keeps triangles in shape."""

PASSED_ON = 2
"""How often what vertices can't be moved is passed on to their neighbors; a choice."""

LEAST_SLOPE = 0.3
"""Least cosine between normal and grid edge that the way along the edge is reckoned with; a choice."""


def bulge(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], grid: Grid, free: int, kinds: NDArray[np.uint8]
) -> None:
    """Move vertices, in place, so that the volume between triangles and curved surface is made up for.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    grid : Grid
        Vertices on its border stay.
    free : int
        Vertices from this number on lie on rims and stay.
    kinds : (m,) uint8
        What faces lie on. Those of the domain stay, so that the part lies in it; without elements all may move.
    """
    low = np.array(grid.origin)
    high = low + (np.array(grid.shape) - 1) * grid.spacing
    normals = np.zeros((len(vertices), 3), np.float32)
    rise, share, room = np.zeros(free, np.float32), np.zeros(free, np.float32), np.full(free, np.inf, np.float32)
    _bulge(vertices, faces, kinds, free, low, high, np.array(grid.spacing), normals, rise, share, room)


@jit
def _cap(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], f: int, low: NDArray[np.float64], high: NDArray[np.float64]
) -> bool:
    """Whether a triangle lies in the border."""
    for axis in range(3):
        for side in (low[axis], high[axis]):
            if (
                abs(vertices[faces[f, 0], axis] - side) < 1e-9
                and abs(vertices[faces[f, 1], axis] - side) < 1e-9
                and abs(vertices[faces[f, 2], axis] - side) < 1e-9
            ):
                return True
    return False


@jit
def _double_area(vertices: NDArray[np.float64], a: int, b: int, c: int) -> float:
    ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
    vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    return math.sqrt(x * x + y * y + z * z)


@jit
def _moved(
    vertices: NDArray[np.float64],
    v: int,
    normals: NDArray[np.float32],
    wanted: float,
    room: NDArray[np.float32],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    spacing: NDArray[np.float64],
) -> np.float32:
    """Move a vertex along its edge of the grid, so that it comes to lie higher by a wanted way; returns by how much.

    What it has moved is taken from its `room`; that of vertices on the border of the grid becomes 0.
    """
    axis, inside = 0, 0
    for a in range(3):
        place = (vertices[v, a] - low[a]) / spacing[a]
        if abs(place - np.floor(place + 0.5)) > 0.75 * EDGE_MARGIN:
            axis = a
            inside += 1
        if abs(vertices[v, a] - low[a]) < 1e-9 or abs(vertices[v, a] - high[a]) < 1e-9:
            room[v] = 0.0
    if inside != 1:
        room[v] = 0.0
    slope = np.float64(normals[v, axis])
    way = wanted * slope / max(slope * slope, LEAST_SLOPE**2)
    way = min(max(way, -room[v]), room[v]) / spacing[axis]
    place = (vertices[v, axis] - low[axis]) / spacing[axis]
    node = np.floor(place)
    way = min(max(place + way - node, EDGE_MARGIN), 1.0 - EDGE_MARGIN) - (place - node)
    if room[v] > 0.0:
        vertices[v, axis] += way * spacing[axis]
        room[v] -= np.float32(abs(way) * spacing[axis])
        return np.float32(way * spacing[axis] * slope)
    return np.float32(0.0)


@jit
def _bulge(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    kinds: NDArray[np.uint8],
    free: int,
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    spacing: NDArray[np.float64],
    normals: NDArray[np.float32],
    rise: NDArray[np.float32],
    share: NDArray[np.float32],
    room: NDArray[np.float32],
) -> None:
    scale = min(spacing[0], spacing[1], spacing[2])
    for f in range(faces.shape[0]):
        if _cap(vertices, faces, f, low, high):
            continue
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        uu, vv = ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz
        ww = uu + vv - 2.0 * (ux * vx + uy * vy + uz * vz)
        if not min(uu, vv, ww) > 0.0:
            continue
        # these weights give the normals of a sphere however it is cut into triangles (Max 1999)
        for v, weight in ((a, scale / (uu * vv)), (b, scale / (uu * ww)), (c, scale / (vv * ww))):
            normals[v, 0] += np.float32(x * weight)
            normals[v, 1] += np.float32(y * weight)
            normals[v, 2] += np.float32(z * weight)
    for v in range(normals.shape[0]):
        length = math.sqrt(normals[v, 0] ** 2 + normals[v, 1] ** 2 + normals[v, 2] ** 2)
        if length > 0.0:
            for axis in range(3):
                normals[v, axis] /= np.float32(length)
    for f in range(faces.shape[0]):
        if kinds.size > 0 and kinds[f] == DOMAIN:
            for c in range(3):
                if faces[f, c] < free:
                    room[faces[f, c]] = 0.0
            continue
        movable = 0
        for c in range(3):
            movable += faces[f, c] < free
        if movable == 0 or _cap(vertices, faces, f, low, high):
            continue
        total = 0.0
        for c in range(3):
            v, w = faces[f, c], faces[f, (c + 1) % 3]
            turn, length = 0.0, 0.0
            for axis in range(3):
                step = vertices[w, axis] - vertices[v, axis]
                length += step * step
                # a normal on a rim says nothing: there the surface is continued with the curvature at the other end
                if v < free and w < free:
                    turn += (normals[w, axis] - normals[v, axis]) * step
                elif v < free:
                    turn -= 2.0 * normals[v, axis] * step
                elif w < free:
                    turn += 2.0 * normals[w, axis] * step
            total += turn / 24.0
            # what is beside a rim stays within the domain
            length = math.sqrt(length) if v < free and w < free else 0.0
            if v < free:
                room[v] = min(room[v], np.float32(length))
            if w < free:
                room[w] = min(room[w], np.float32(length))
        area = _double_area(vertices, faces[f, 0], faces[f, 1], faces[f, 2])
        for corner in range(3):
            v = faces[f, corner]
            if v < free:
                rise[v] += np.float32(area * total * 3.0 / movable)
                share[v] += np.float32(area)
    for v in range(free):
        room[v] *= np.float32(MOST)
        if share[v] > 0.0:
            rise[v] /= share[v]
    # what a vertex can't be moved is left to its neighbors
    more = np.zeros_like(rise)
    for passing in range(1 + PASSED_ON):
        for v in range(free):
            wanted = rise[v] if passing == 0 else more[v]
            if share[v] > 0.0 and room[v] > 0.0:
                wanted -= _moved(vertices, v, normals, wanted, room, low, high, spacing)
            rise[v], more[v] = wanted, 0.0
        if passing == PASSED_ON:
            break
        for f in range(faces.shape[0]):
            if kinds.size > 0 and kinds[f] == DOMAIN:
                continue
            for c in range(3):
                v, w, u = faces[f, c], faces[f, (c + 1) % 3], faces[f, (c + 2) % 3]
                if v >= free or rise[v] == 0.0:
                    continue
                to_w, to_u = w < free and room[w] > 0.0, u < free and room[u] > 0.0
                part = rise[v] * _double_area(vertices, v, w, u) / np.float32(2.0 if to_w and to_u else 1.0)
                if to_w:
                    more[w] += np.float32(part / share[w])
                if to_u:
                    more[u] += np.float32(part / share[u])
