"""The steps of `bulging` that move vertices, and pass on what is left; each for the triangles or vertices of a piece.

`vertices` and the other arrays of a window begin with vertex number `base`; a corner -1 - p stands for points[p].
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.surface.numerics.bulging_sums import AT_ONCE, SIDES, find_corners
from sppm_pipeline.features.surface.numerics.placing import DOMAIN
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN

MAX_MOVE = 0.3
"""Vertices are moved by at most this fraction of their shortest edge, so that triangles cannot fold (from one half on).
At half of it more volume has to be passed on to neighbors."""

LEAST_SLOPE = 0.3
"""Least cosine between normal and grid edge with which the way along the edge is computed: it grows as the inverse, and
is capped at about three times the rise."""

NEGLIGIBLE = 3e-4
"""Moves below this fraction of the spacing are dropped; passing them on would take time and change next to nothing."""


_NO_AXIS = 3
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


@jit
def move(
    vertices: NDArray[np.float64], places: NDArray[np.uint8], normals: NDArray[np.float32], rise: NDArray[np.float32],
    more: NDArray[np.float32], share: NDArray[np.float32], room: NDArray[np.float32], taken: NDArray[np.float32],
    notes: NDArray[np.uint8], first: int, stop: int, low: NDArray[np.float64], spacing: NDArray[np.float64],
    wholly: bool,
) -> None:  # fmt: skip
    """Move vertices as far as they should, or else have to for their neighbors; `rise` keeps what is left to move.

    They move along their edges of the grid, so that they come to lie higher by the wanted way. Those on the border of
    the grid stay. How far a vertex was moved is taken from its `room`; what is true of it afterwards goes into `notes`.
    """
    least = NEGLIGIBLE * min(spacing[0], spacing[1], spacing[2])
    at, lows, steps, slopes = np.empty(AT_ONCE), np.empty(AT_ONCE), np.empty(AT_ONCE), np.empty(AT_ONCE)
    free, nothing = np.empty(AT_ONCE, np.uint8), np.float32(0.0)
    for begin in range(np.uint64(first), np.uint64(stop), np.uint64(AT_ONCE)):
        n = min(np.uint64(AT_ONCE), np.uint64(stop) - begin)
        for i in range(n):
            v = begin + i
            free[i] = places[v] >> 6 != _NO_AXIS and not places[v] & SIDES
            axis = np.uint64(places[v] >> 6 if free[i] else 0)
            at[i], lows[i], steps[i], slopes[i] = vertices[v, axis], low[axis], spacing[axis], normals[v, axis]
        for i in range(n):
            v = begin + i
            space, known = room[v], share[v] > nothing
            want = more[v]
            if wholly:
                space = np.float32(MAX_MOVE) * np.sqrt(space)
                want = rise[v] / share[v] if known else rise[v]
            wanted, step, slope, most = np.float64(want), steps[i], slopes[i], np.float64(space)
            asked = (wanted != 0.0) & known
            has_room = asked & (space > nothing)
            moves = has_room & (free[i] != 0)
            place = (at[i] - lows[i]) / step
            # rise over slope, with the slope bounded from below: along an edge nearly in the surface the way
            # would be endless
            way = wanted * slope / max(slope * slope, LEAST_SLOPE**2)
            way = min(max(way, -most), most) / step
            start = place - np.floor(place)
            # the vertex stays within its edge: the topology of marching cubes holds
            way = min(max(start + way, EDGE_MARGIN), 1.0 - EDGE_MARGIN) - start
            at[i] = at[i] + way * step if moves else at[i]
            left = space - np.float32(abs(way) * step)
            space = left if moves else nothing if has_room else space
            wanted = wanted - way * step * slope if moves else wanted
            rest = np.float32(wanted) if asked & (abs(wanted) > least) else nothing
            taken[v], rise[v], more[v], room[v] = nothing, rest, nothing, space
            notes[v] = np.uint8(_LEFT * (rest != nothing) | _MOVABLE * (space > nothing))
        for i in range(n):
            if free[i]:
                vertices[begin + i, np.uint64(places[begin + i] >> 6)] = at[i]


@jit
def find_takers(
    vertices: NDArray[np.float64], taken: NDArray[np.float32], notes: NDArray[np.uint8], points: NDArray[np.float64],
    faces: NDArray[np.int32], kinds: NDArray[np.uint8], base: int, chosen: NDArray[np.int32],
    areas: NDArray[np.float64],
) -> int:  # fmt: skip
    """Add up the triangles with a corner to which another one can leave something; returns how many there are.

    Their numbers and twice their areas go into `chosen` and `areas`, which have room for all.
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
            find_corners(faces, f, base, vertices, points, corners)
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
        if (faces[f, 0] | faces[f, 1] | faces[f, 2]) < 0:
            movable = np.uint8(0)
            for corner in range(3):
                if faces[f, corner] >= 0:
                    movable += notes[np.uint64(faces[f, corner]) - begin] >> 1
            for corner in range(3):
                if faces[f, corner] >= 0:
                    taker = np.uint64(faces[f, corner]) - begin
                    if notes[taker] & _LEFT and movable > notes[taker] >> 1:
                        taken[taker] += area
        else:  # nothing is added where nothing is left, as that costs less than to be wrong about it
            of_a, of_b, of_c, nothing = notes[a], notes[b], notes[c], np.float32(0.0)
            taken[a] += area if of_a & _LEFT and (of_b | of_c) & _MOVABLE else nothing
            taken[b] += area if of_b & _LEFT and (of_a | of_c) & _MOVABLE else nothing
            taken[c] += area if of_c & _LEFT and (of_a | of_b) & _MOVABLE else nothing
    return n


@jit
def pass_on(
    rise: NDArray[np.float32], more: NDArray[np.float32], share: NDArray[np.float32], taken: NDArray[np.float32],
    notes: NDArray[np.uint8], faces: NDArray[np.int32], base: int, chosen: NDArray[np.int32],
    areas: NDArray[np.float64],
) -> None:  # fmt: skip
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
