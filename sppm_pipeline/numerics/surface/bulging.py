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

MOST = 0.2
"""Vertices are moved by at most this fraction of their shortest edge; a choice that keeps triangles in shape."""

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
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area = math.sqrt(x * x + y * y + z * z)
        for corner in range(3):
            v = faces[f, corner]
            if v < free:
                rise[v] += np.float32(area * total * 3.0 / movable)
                share[v] += np.float32(area)
    for v in range(free):
        axis, inside, border = 0, 0, False
        for a in range(3):
            place = (vertices[v, a] - low[a]) / spacing[a]
            if abs(place - np.floor(place + 0.5)) > 0.75 * EDGE_MARGIN:
                axis = a
                inside += 1
            border |= abs(vertices[v, a] - low[a]) < 1e-9 or abs(vertices[v, a] - high[a]) < 1e-9
        if border or inside != 1 or not share[v] > 0.0:
            continue
        slope = np.float64(normals[v, axis])
        most = MOST * room[v]
        way = rise[v] / share[v] * slope / max(slope * slope, LEAST_SLOPE**2)
        way = min(max(way, -most), most) / spacing[axis]
        place = (vertices[v, axis] - low[axis]) / spacing[axis]
        node = np.floor(place)
        share_moved = min(max(place + way - node, EDGE_MARGIN), 1.0 - EDGE_MARGIN)
        vertices[v, axis] = low[axis] + (node + share_moved) * spacing[axis]
