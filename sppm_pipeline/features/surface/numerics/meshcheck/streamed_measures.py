"""Measures of a mesh that comes in pieces, found while what they need is still at hand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.mesh.measures import add_sums, edge_balance, nothing_found, read_only

_NO_RIMS = np.empty((0, 3))


class StreamedMeasures:
    """`box_and_volume` and `balanced_edges` of a mesh that comes in pieces, to the bit.

    Vertices come scaled and moved; points on rims are taken times the scale and moved by the origin here.
    """

    def __init__(self, scale: float, origin: NDArray[np.float64]) -> None:
        self._scale, self._origin = scale, origin
        self._before, self._base = np.empty((0, 3)), 0
        self._start: NDArray[np.float64] | None = None
        self._found, self._balance = nothing_found(), 0

    def add(self, vertices: NDArray[np.float64], faces: NDArray[np.int32], rims: NDArray[np.float64]) -> None:
        """Take the next piece: vertices (n, 3) that follow upon those before, faces (m, 3), points on rims (k, 3).

        Corners lie in this piece and the one before; negative numbers -1 - p stand for rims[p].
        """
        both = np.concatenate([self._before, vertices])
        self.add_window(both, self._base, faces, rims)
        self._base += len(self._before)
        self._before = both[len(self._before) :]

    def add_window(
        self, both: NDArray[np.float64], base: int, faces: NDArray[np.int32], rims: NDArray[np.float64] = _NO_RIMS
    ) -> None:
        """`add`, with the vertices of the piece before in front; the first of them has the number `base`."""
        if len(faces):
            if self._start is None:
                v = int(faces[0, 0])
                self._start = both[v - base].copy() if v >= 0 else rims[-1 - v] * self._scale + self._origin
            numbered = read_only(faces)
            given = read_only(both), base, numbered, read_only(rims), self._scale, self._origin
            add_sums(*given, self._start, self._found)
            # a sum of hashes of the edges with their directions, modulo the word it is kept in
            self._balance = (self._balance + int(edge_balance(numbered))) % 2**64

    @property
    def balanced(self) -> bool:
        """True if every edge runs as often in one direction as in the other; False without triangles."""
        return self._start is not None and self._balance == 0

    @property
    def box_and_volume(self) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        """Low and high corner, (3,) each, and volume."""
        return self._found[3:6].copy(), self._found[6:].copy(), float(self._found[0] / 6.0)
