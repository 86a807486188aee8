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
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.surface.numerics.bulging_steps import find_places, find_takers, move, pass_on
from sppm_pipeline.features.surface.numerics.bulging_sums import add_normals, add_rises, to_unit_length
from sppm_pipeline.services.grid import Grid

PASSED_ON = 2
"""Rounds in which what is left of moves that are too far is passed on to neighbors, a heuristic: each round reaches one
ring of vertices farther and takes as much time."""

_Chosen = tuple[NDArray[np.int32], NDArray[np.float64]]

_NONE, _NOTHING = np.empty(0, np.int32), np.empty(0)
_LAG = 2 + 2 * PASSED_ON  # pieces that must have followed until the vertices of a piece are done
_ROOM = 2  # the buffer holds so many times what is in use, so that it is seldom moved


class Window(NamedTuple):
    """Vertices that are worked on."""

    vertices: NDArray[np.float64]  # (n, 3)
    # (n,), on which sides of the grid a vertex lies, and along which axis it may be moved (`find_places`)
    places: NDArray[np.uint8]
    normals: NDArray[np.float32]  # (n, 3)
    rise: NDArray[np.float32]  # (n,), how far to move a vertex
    more: NDArray[np.float32]  # (n,), what its neighbors leave to it
    share: NDArray[np.float32]  # (n,), twice the area of its triangles
    room: NDArray[np.float32]  # (n,), how far it may be moved; before that, the square of its shortest edge
    lost: NDArray[np.float32]  # (n,), six times the volume lost beside a vertex
    # (n,), twice the area of the triangles of a vertex with another corner that can be moved
    taken: NDArray[np.float32]
    notes: NDArray[np.uint8]  # (n,), what `move` has noted of a vertex


class _Piece(NamedTuple):
    first: int  # number of its first vertex
    stop: int
    faces: NDArray[np.int32]
    kinds: NDArray[np.uint8]


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
        self,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int32],
        kinds: NDArray[np.uint8],
        points: NDArray[np.float64],
        losers: NDArray[np.int32] = _NONE,
        lost: NDArray[np.float64] = _NOTHING,
    ) -> Iterator[NDArray[np.float64]]:
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

    def finish(self, points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        """The vertices of the last pieces, once no more follow."""
        for _ in range(_LAG):
            self._append(np.empty((0, 3)), np.empty((0, 3), np.int32), np.empty(0, np.uint8))
            yield from self._work(points)

    def _append(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], kinds: NDArray[np.uint8]) -> None:
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

    def _work(self, points: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
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

    def _takers(self, points: NDArray[np.float64], piece: _Piece) -> _Chosen:
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
