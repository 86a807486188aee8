"""A mesh that is handed over piece by piece while it is made, to what writes or measures it."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray


class ExpectedSize(NamedTuple):
    """Size of a mesh that is about to be made, certain."""

    vertices: int
    faces: int
    least: NDArray[np.float64]  # (2, 3): low and high corner; the box of the vertices reaches as far as this
    most: NDArray[np.float64]  # and no farther than this

    def moved(self, scale: float, origin: NDArray[np.float64]) -> ExpectedSize:
        """Of the mesh times a scale, and moved by an origin."""
        return self._replace(least=self.least * scale + origin, most=self.most * scale + origin)

    @property
    def reach(self) -> tuple[float, float]:
        """Between these lies the largest absolute coordinate."""
        least, most = (max(float(box[1].max()), float(-box[0].min())) for box in (self.least, self.most))
        return least, most


class PieceTaker(Protocol):
    """Consumer of the pieces of a mesh while the next ones are made, such as the writer of a file."""

    def begin(self, expected: ExpectedSize) -> bool:
        """Return whether such a mesh can be taken in pieces; called before anything else, once for each try."""

    def add(self, points: NDArray[np.float64], base: int, known: int, faces: NDArray[np.int32]) -> None:
        """Take the triangles (m, 3) of the next piece, all with corners among these points.

        The points (n, 3) are the vertices of the piece before, `known` of them, and of this one, numbered from `base`
        on; they stay as they are until the call after the next one.
        """

    def finish(self) -> bool:
        """Return whether the mesh is complete and of the expected size; if not, nothing of it is used."""

    def drop(self) -> None:
        """Discard all pieces."""
