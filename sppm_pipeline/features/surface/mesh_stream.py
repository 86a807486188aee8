"""A mesh that comes in pieces, as it is extracted, and the points on its rims.

Numbers of vertices and triangles that marching cubes will make, and their box, from the runs of the solid.

Exact, as both depend on the signs of the samples alone; so a file can begin with the counts before there is a mesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sppm_pipeline.method.connectivity.runs import Runs
from sppm_pipeline.method.nouns.mesh import ExpectedSize
from sppm_pipeline.services.arrays import F64, I32, I64, U8, U64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_tables import case_tables
from sppm_pipeline.services.mesh.sign_words import ONE, lowest, mixed_cells, ones, plane_crossings, shifted_word
from sppm_pipeline.services.threads import in_bands

if TYPE_CHECKING:
    from sppm_pipeline.features.surface.field_surface import SampledSlabs
    from sppm_pipeline.features.surface.numerics.rims import Split

_ALL, _LAST = np.uint64(0xFFFFFFFFFFFFFFFF), np.int64(63)


class Counts(NamedTuple):
    """Counts of a mesh to come."""

    vertices: int
    faces: int
    low: I64  # (3,), first node of the solid along x, y, z; of no meaning without triangles
    high: I64  # (3,), the last one


def count_mesh(runs: Runs, keep: Bools, capped: bool, threads: int = 1) -> Counts:
    """Count the vertices and triangles that `capped_marching_cubes_slabs` makes of a solid.

    Runs that `keep`, (n,) bool, marks are solid. If `capped`, the surface is closed at the outermost nodes of each
    axis; else it ends there.
    """
    nz, ny, nx = runs.shape
    # a cap is what marching cubes makes of a border of void
    pad = int(capped)
    size, table = np.array([nz, ny, nx], np.int64), case_tables().counts
    found: list[tuple[int, int]] = []

    def count(start: int, stop: int) -> None:
        found.append(_count(runs.rows, runs.bounds, keep, size, pad, start, stop, table))

    in_bands(count, nz + 2 * pad, threads)
    box = np.empty((2, 3), np.int64)
    _find_box(runs.rows, runs.bounds, keep, size, box)
    return Counts(sum(vertices for vertices, _ in found), sum(faces for _, faces in found), box[0], box[1])


@jit
def _fill_plane(rows: I64, bounds: I32, keep: Bools, size: I64, pad: int, plane: int, words: U64) -> None:
    """The signs of a plane, which is void if it lies outside of the solid's."""
    words[:] = np.uint64(0)
    if plane < pad or plane >= size[0] + pad:
        return
    row = (plane - pad) * size[1]
    for y in range(size[1]):
        for r in range(rows[row + y], rows[row + y + 1]):
            if not keep[r]:
                continue
            first, last = np.int64(bounds[2 * r]) + pad, np.int64(bounds[2 * r + 1]) + pad - 1
            head, tail = _ALL << np.uint64(first & _LAST), _ALL >> np.uint64(_LAST - (last & _LAST))
            w, end = first >> 6, last >> 6
            if w == end:
                words[y + pad, w] |= head & tail
                continue
            words[y + pad, w] |= head
            for between in range(w + 1, end):
                words[y + pad, between] = _ALL
            words[y + pad, end] |= tail


@jit
def _count(
    rows: I64, bounds: I32, keep: Bools, size: I64, pad: int, start: int, stop: int, table: U8
) -> tuple[int, int]:
    """Vertices and triangles of the planes start <= p < stop, and between each of them and the plane before it."""
    ny, nx = size[1] + 2 * pad, size[2] + 2 * pad
    low, high = np.empty((ny, (nx + 63) // 64), np.uint64), np.empty((ny, (nx + 63) // 64), np.uint64)
    vertices, faces = int(np.int64(0)), int(np.int64(0))
    if start > 0:
        _fill_plane(rows, bounds, keep, size, pad, start - 1, high)
    for p in range(start, stop):
        low, high = high, low
        _fill_plane(rows, bounds, keep, size, pad, p, high)
        vertices += plane_crossings(high, nx)
        if p == 0:
            continue
        for j in range(ny):
            for w in range(low.shape[1]):
                vertices += ones(low[j, w] ^ high[j, w])
                bits = mixed_cells(low, high, j, w, nx) if j + 1 < ny else np.uint64(0)
                if bits == 0:
                    continue
                s0, s1, s2, s3 = low[j, w], low[j + 1, w], high[j, w], high[j + 1, w]
                n0, n1 = shifted_word(low, j, w), shifted_word(low, j + 1, w)
                n2, n3 = shifted_word(high, j, w), shifted_word(high, j + 1, w)
                while bits != 0:
                    k = np.uint64(lowest(bits))
                    bits &= bits - ONE
                    case = (s0 >> k) & ONE | ((n0 >> k) & ONE) << np.uint64(1)
                    case |= ((s1 >> k) & ONE) << np.uint64(2) | ((n1 >> k) & ONE) << np.uint64(3)
                    case |= ((s2 >> k) & ONE) << np.uint64(4) | ((n2 >> k) & ONE) << np.uint64(5)
                    case |= ((s3 >> k) & ONE) << np.uint64(6) | ((n3 >> k) & ONE) << np.uint64(7)
                    faces += int(table[case])
    return vertices, faces


@jit
def _find_box(rows: I64, bounds: I32, keep: Bools, size: I64, box: I64) -> None:
    box[0, 0], box[0, 1], box[0, 2] = size[2], size[1], size[0]
    box[1] = -1
    for row in range(size[0] * size[1]):
        for r in range(rows[row], rows[row + 1]):
            if keep[r]:
                z, y = row // size[1], row % size[1]
                box[0, 0] = min(box[0, 0], np.int64(bounds[2 * r]))
                box[1, 0] = max(box[1, 0], np.int64(bounds[2 * r + 1]) - 1)
                box[0, 1], box[1, 1] = min(box[0, 1], y), max(box[1, 1], y)
                box[0, 2], box[1, 2] = min(box[0, 2], z), max(box[1, 2], z)


class MeshPiece(NamedTuple):
    """Some vertices and triangles of a mesh."""

    # (n, 3), following upon those of the pieces before; valid until the next piece is asked for
    vertices: F64
    # (m, 3), by numbers in the whole mesh, of this piece and those before; -1 - p is point p of those on rims
    faces: I32
    kinds: U8  # (m,), what each face lies on, or without elements


class MeshStream:
    """A mesh, to be read once: its pieces, the points on their rims, and the samples they are made from."""

    def __init__(self, pieces: Iterator[MeshPiece], rims: RimPoints, source: SampledSlabs) -> None:
        self._pieces = pieces
        self._rims = rims
        self._source = source

    def __iter__(self) -> Iterator[MeshPiece]:
        return self._pieces

    @property
    def points(self) -> F64:
        """The points on rims that the pieces so far have, (k, 3)."""
        return self._rims.points

    @property
    def expected(self) -> tuple[int, int]:
        """About how many vertices and triangles there will be; zeros if that is not known."""
        return self._source.expected

    @property
    def findings(self) -> dict[str, Any]:
        """Removed solid and other findings."""
        return self._source.findings

    def predicted(self) -> ExpectedSize | None:
        """Predicted counts and box of the mesh, which take some time; None if they cannot be known."""
        return None if self._source.predict is None else self._source.predict()


class RimPoints:
    """Points on the rims of a mesh, numbered in the order of their first use.

    A point in the face between two cubes is found from both; those of two pieces meet in the plane between them, so
    the keys of the piece before are all that has to be remembered.
    """

    def __init__(self) -> None:
        self._room = np.empty((0, 3))
        self._count = 0
        self._keys = np.empty(0, np.int64)  # of the piece before
        self._numbers = np.empty(0, np.int64)

    @property
    def points(self) -> F64:
        """All points so far, (k, 3)."""
        return self._room[: self._count]

    def numbered(self, split: Split) -> I32:
        """Keep the new points of a piece; its faces, with negative numbers -1 - p for points[p]."""
        if not len(split.points):
            self._keys, self._numbers = np.empty(0, np.int64), np.empty(0, np.int64)
            return split.faces
        known = len(self._keys)
        keys, first, of_key = np.unique(
            np.concatenate([self._keys, split.keys]), return_index=True, return_inverse=True
        )
        new = np.flatnonzero(first >= known)
        new = new[np.argsort(first[new])]  # by their first use
        numbers = np.empty(len(keys), np.int64)
        old = first < known
        numbers[old] = self._numbers[first[old]]
        numbers[new] = self._count + np.arange(len(new))
        self._append(split.points[first[new] - known])
        from sppm_pipeline.features.surface.numerics.rim_points import renumber_points

        used = of_key.reshape(-1)[known:]
        renumber_points(split.faces, numbers[used])
        here = np.unique(used)
        self._keys, self._numbers = keys[here], numbers[here]
        return split.faces

    def _append(self, points: F64) -> None:
        total = self._count + len(points)
        if total > len(self._room):
            grown = np.empty((2 * total, 3))
            grown[: self._count] = self.points
            self._room = grown
        self._room[self._count : total] = points
        self._count = total


class PieceWindow:
    """The vertices of a piece behind those of the piece before, times a scale and moved by an origin (3,)."""

    def __init__(self, scale: float, origin: F64) -> None:
        self._scale, self._origin = scale, origin
        self._rooms = [np.empty((0, 3)), np.empty((0, 3))]  # in turn, so that the last but one stays as it is
        self._last = np.empty((0, 3))
        self.base = self.known = 0
        """Number of the first vertex, and how many are of the piece before."""

    def push(self, vertices: F64) -> F64:
        """Take the next vertices, (n, 3); the window, which stays as it is until the call after the next one."""
        from sppm_pipeline.features.surface.numerics.placing import put_rescaled

        self.base += self.known
        self.known = len(self._last)
        count = self.known + len(vertices)
        self._rooms.reverse()
        if count > len(self._rooms[0]):
            self._rooms[0] = np.empty((count + count // 4, 3))
        window = self._rooms[0][:count]
        window[: self.known] = self._last
        put_rescaled(vertices, self._scale, self._origin, window[self.known :])
        self._last = window[self.known :]
        return window
