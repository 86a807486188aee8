"""Flat triangles on a curved surface: moved outwards by what they cut off.

A mesh whose vertices all lie on a curved surface is too thin where the solid is convex and too thick where it is
concave, by a volume that falls with the square of the spacing only. Over an edge the surface rises by ``s^2 k / 8``,
with the length s and the curvature k, which is the turn of the normals along the edge over its length; a parabolic
patch rises over a triangle by a third of the sum of its three edges on average. Every vertex is moved by the
mean rise of its triangles, so that the mesh encloses what the surface does: along its edge of the grid, not its normal,
so that the surface in a cube stays in it and runs into no other sheet nearby. What a vertex may not be moved its
neighbors are, so that the volume is kept; and the surroundings of a rim get what of the solid beyond it no edge of the
grid has found (`rim_points`).

The mesh comes in pieces, whose triangles have corners in their own and in the piece before. So each step of the work
runs a piece behind the step before it, and the result is the same to the bit as that of step after step over all.

The steps of `bulging` that move vertices, and pass on what is left; each for the triangles or vertices of a piece.

`vertices` and the other arrays of a window begin with vertex number `base`; a corner -1 - p stands for points[p].
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.surface.numerics.bulging_sums import (
    AT_ONCE,
    SIDES,
    add_normals,
    add_rises,
    find_corners,
    to_unit_length,
)
from sppm_pipeline.features.surface.numerics.placing import DOMAIN
from sppm_pipeline.services.arrays import F32, F64, I32, U8
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import EDGE_MARGIN

MAX_MOVE = 0.3
"""Vertices are moved by at most this fraction of their shortest edge, so that triangles cannot fold (from one half on).
At half of it more volume has to be passed on to neighbors."""

MIN_SLOPE = 0.3
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
def find_places(vertices: F64, box: F64, spacing: F64, places: U8) -> None:
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
    vertices: F64, places: U8, normals: F32, rise: F32, more: F32, share: F32, room: F32, taken: F32, notes: U8,
    first: int, stop: int, low: F64, spacing: F64, wholly: bool,
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
            way = wanted * slope / max(slope * slope, MIN_SLOPE**2)
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
    vertices: F64, taken: F32, notes: U8, points: F64, faces: I32, kinds: U8, base: int, chosen: I32, areas: F64
) -> int:
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
    rise: F32, more: F32, share: F32, taken: F32, notes: U8, faces: I32, base: int, chosen: I32, areas: F64
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


PASSED_ON = 2
"""Rounds in which what is left of moves that are too far is passed on to neighbors, a heuristic: each round reaches one
ring of vertices farther and takes as much time."""

_Chosen = tuple[I32, F64]

_NONE, _NOTHING = np.empty(0, np.int32), np.empty(0)
_LAG = 2 + 2 * PASSED_ON  # pieces that must have followed until the vertices of a piece are done
_ROOM = 2  # the buffer holds so many times what is in use, so that it is seldom moved


class Window(NamedTuple):
    """Vertices that are worked on."""

    vertices: F64  # (n, 3)
    # (n,), on which sides of the grid a vertex lies, and along which axis it may be moved (`find_places`)
    places: U8
    normals: F32  # (n, 3)
    rise: F32  # (n,), how far to move a vertex
    more: F32  # (n,), what its neighbors leave to it
    share: F32  # (n,), twice the area of its triangles
    room: F32  # (n,), how far it may be moved; before that, the square of its shortest edge
    lost: F32  # (n,), six times the volume lost beside a vertex
    # (n,), twice the area of the triangles of a vertex with another corner that can be moved
    taken: F32
    notes: U8  # (n,), what `move` has noted of a vertex


class _Piece(NamedTuple):
    first: int  # number of its first vertex
    stop: int
    faces: I32
    kinds: U8


class Bulging:
    """Move vertices so that the volume between triangles and curved surface is made up for; the border stays."""

    def __init__(self, grid: Grid) -> None:
        low = np.array(grid.origin)
        self._box = np.stack([low, low + (np.array(grid.shape) - 1) * grid.spacing])
        self._spacing = np.array(grid.spacing)
        self._window = _window_of(0)
        self._base = self._stop = 0  # numbers of the vertices in the window
        self._pieces: deque[_Piece] = deque()  # the newest one first
        self._room: _Chosen = _NONE, _NOTHING
        # what a piece passes on is known once the next one was seen: one set of triangles waits for each
        # round
        self._chosen = [self._room] * PASSED_ON

    def push(
        self, vertices: F64, faces: I32, kinds: U8, points: F64, losers: I32 = _NONE, lost: F64 = _NOTHING
    ) -> Iterator[F64]:
        """Take a piece; yields vertices of earlier ones that are done, to be used before the next piece comes.

        `vertices`, (n, 3), follow upon those of the pieces before. `faces`, (m, 3), have corners in this piece and the
        one before; -1 - p stands for points[p], which lie on rims and stay. Faces of the domain by their `kinds`, (m,),
        stay, so that the part lies in it; without elements all may move. `losers` are vertices of this piece or the one
        before whose surroundings shall gain the volumes `lost`, in voxels.
        """
        if len(vertices) or len(faces):
            self._append(vertices, faces, kinds)
            # six times the volume is twice the area times the rise
            np.add.at(self._window.lost, losers - self._base, np.float32(6.0 * self._spacing.prod()) * lost)
            yield from self._work(points)

    def finish(self, points: F64) -> Iterator[F64]:
        """The vertices of the last pieces, once no more follow."""
        for _ in range(_LAG):
            self._append(np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty(0, np.uint8))
            yield from self._work(points)

    def _append(self, vertices: F64, faces: I32, kinds: U8) -> None:
        used, more = self._stop - self._base, len(vertices)
        if used + more > len(self._window.vertices):
            first = self._pieces[-1].first if self._pieces else self._stop
            drop, old = first - self._base, self._window
            if _ROOM * (used - drop + more) > len(old.vertices):
                self._window = _window_of(2 * _ROOM * (used - drop + more))
            arrays: Iterator[tuple[NDArray[Any], NDArray[Any]]] = zip(self._window, old, strict=True)
            for now, before in arrays:
                now[: used - drop] = before[drop:used]  # NumPy sees to overlaps
            self._base += drop
            used -= drop
        new = slice(used, used + more)
        self._window.vertices[new] = vertices
        _, _, normals, rise, more_rise, share, _, lost, taken, _ = self._window
        for values in (normals, rise, more_rise, share, lost, taken):
            values[new] = 0.0
        self._window.room[new] = np.inf
        find_places(self._window.vertices[new], self._box, self._spacing, self._window.places[new])
        self._pieces.appendleft(_Piece(self._stop, self._stop + more, faces, kinds))
        self._stop += more

    def _work(self, points: F64) -> Iterator[F64]:
        """Each step for the piece whose turn it is."""
        base, spacing, pieces = self._base, self._spacing, self._pieces
        vertices, places, normals, rise, more, share, room, lost, taken, notes = self._window
        add_normals(vertices, places, normals, points, pieces[0].faces, base, float(spacing.min()))
        if len(pieces) > 1:
            first, stop, faces, kinds = pieces[1]
            to_unit_length(normals[first - base : stop - base])
            add_rises(vertices, places, normals, rise, share, room, points, faces, kinds, base)
        for passing in range(1 + PASSED_ON):
            turn = 2 + 2 * passing
            if len(pieces) <= turn:
                return
            first, stop, faces, kinds = pieces[turn]
            low, wholly = self._box[0], passing == 0
            if wholly:
                rise[first - base : stop - base] += lost[first - base : stop - base]
            move(
                vertices, places, normals, rise, more, share, room, taken, notes, first - base, stop - base, low,
                spacing, wholly,
            )  # fmt: skip
            if passing < PASSED_ON:
                # what there is to leave it to is known for a vertex when the piece that follows has been seen
                before = self._chosen[passing]
                self._chosen[passing] = self._takers(points, pieces[turn])
                if len(pieces) > turn + 1:
                    pass_on(rise, more, share, taken, notes, pieces[turn + 1].faces, base, *before)
        done = pieces.pop()
        yield vertices[done.first - base : done.stop - base]

    def _takers(self, points: F64, piece: _Piece) -> _Chosen:
        """The triangles of a piece within which something is passed on, with their areas."""
        faces, (vertices, *_, taken, notes) = piece.faces, self._window
        if len(faces) > len(self._room[0]):
            self._room = np.empty(len(faces), np.int32), np.empty(len(faces))
        n = find_takers(vertices, taken, notes, points, faces, piece.kinds, self._base, *self._room)
        return self._room[0][:n].copy(), self._room[1][:n].copy()


def _window_of(room: int) -> Window:
    vertices, normals = np.empty((room, 3)), np.empty((room, 3), np.float32)
    rise, more, share, space, lost, taken = (np.empty(room, np.float32) for _ in range(6))
    places, notes = np.empty(room, np.uint8), np.empty(room, np.uint8)
    return Window(vertices, places, normals, rise, more, share, space, lost, taken, notes)
