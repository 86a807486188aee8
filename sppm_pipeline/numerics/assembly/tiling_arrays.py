"""Which interior and which faces stand where in a tiling."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.assembly.pieces import Pieces


class TilingArrays(NamedTuple):
    """Content of a box of nx x ny x nz cells; cell (i, j, k) fills [i, i+1] x [j, j+1] x [k, k+1].

    Attributes
    ----------
    interior : (nx, ny, nz) int32
        Interior of each cell, -1 = no cell.
    faces : tuple of 3 int32 arrays
        ``faces[axis]`` has the shape of `interior`, but one more along `axis`: the color of the face in lattice
        plane i of that axis, which is the low side of cell i; -1 = no face.
    periodic : bool
        Everything repeats for ever, and the last plane of faces is the first one.
    """

    interior: NDArray[np.int32]
    faces: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
    periodic: bool

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells along x, y, z."""
        nx, ny, nz = self.interior.shape
        return nx, ny, nz


def lone_periodic_cell(interior: int = 0, colors: tuple[int, int, int] = (0, 0, 0)) -> TilingArrays:
    """One cell whose opposite faces are the same: a periodic tiling of 1 x 1 x 1 cells."""
    faces = []
    for axis in range(3):
        shape = [1, 1, 1]
        shape[axis] = 2
        faces.append(np.full(shape, colors[axis], dtype=np.int32))
    return TilingArrays(np.full((1, 1, 1), interior, dtype=np.int32), (faces[0], faces[1], faces[2]), True)


def check_tiling(tiling: TilingArrays, pieces: Pieces | None = None) -> None:
    """Check shapes, and with `pieces` that every interior and color exists.

    Raises
    ------
    ValueError
        If a shape is wrong, the first and last plane of faces of a periodic tiling differ, or a number names no
        piece.
    """
    shape = tiling.shape
    for axis, faces in enumerate(tiling.faces):
        expected = tuple(size + (a == axis) for a, size in enumerate(shape))
        if faces.shape != expected:
            raise ValueError(f"faces of axis {axis} have the shape {faces.shape}, expected {expected}")
        if tiling.periodic and (np.take(faces, 0, axis) != np.take(faces, -1, axis)).any():
            raise ValueError(f"the tiling is periodic, but the first and last faces of axis {axis} differ")
        if pieces is not None and faces.max(initial=-1) >= len(pieces.faces[axis]):
            raise ValueError(f"a face of axis {axis} has color {faces.max()}, of {len(pieces.faces[axis])} colors")
    if pieces is not None and tiling.interior.max(initial=-1) >= len(pieces.interiors):
        raise ValueError(f"a cell has interior {tiling.interior.max()}, of {len(pieces.interiors)} interiors")
