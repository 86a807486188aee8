"""A mesh that comes in pieces, as it is extracted, and the points on its rims."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.nouns.mesh import ExpectedSize

if TYPE_CHECKING:
    from sppm_pipeline.features.surface.field_surface import SampledSlabs
    from sppm_pipeline.features.surface.numerics.rims import Split


class MeshPiece(NamedTuple):
    """Some vertices and triangles of a mesh."""

    # (n, 3), following upon those of the pieces before; valid until the next piece is asked for
    vertices: NDArray[np.float64]
    # (m, 3), by numbers in the whole mesh, of this piece and those before; -1 - p is point p of those on rims
    faces: NDArray[np.int32]
    kinds: NDArray[np.uint8]  # (m,), what each face lies on, or without elements


class MeshStream:
    """A mesh, to be read once: its pieces, the points on their rims, and the samples they are made from."""

    def __init__(self, pieces: Iterator[MeshPiece], rims: RimPoints, source: SampledSlabs) -> None:
        self._pieces = pieces
        self._rims = rims
        self._source = source

    def __iter__(self) -> Iterator[MeshPiece]:
        return self._pieces

    @property
    def points(self) -> NDArray[np.float64]:
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
    def points(self) -> NDArray[np.float64]:
        """All points so far, (k, 3)."""
        return self._room[: self._count]

    def numbered(self, split: Split) -> NDArray[np.int32]:
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

    def _append(self, points: NDArray[np.float64]) -> None:
        total = self._count + len(points)
        if total > len(self._room):
            grown = np.empty((2 * total, 3))
            grown[: self._count] = self.points
            self._room = grown
        self._room[self._count : total] = points
        self._count = total


class PieceWindow:
    """The vertices of a piece behind those of the piece before, times a scale and moved by an origin (3,)."""

    def __init__(self, scale: float, origin: NDArray[np.float64]) -> None:
        self._scale, self._origin = scale, origin
        self._rooms = [np.empty((0, 3)), np.empty((0, 3))]  # in turn, so that the last but one stays as it is
        self._last = np.empty((0, 3))
        self.base = self.known = 0
        """Number of the first vertex, and how many are of the piece before."""

    def push(self, vertices: NDArray[np.float64]) -> NDArray[np.float64]:
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
