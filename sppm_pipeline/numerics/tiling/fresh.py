"""Fresh content: every cell and every face of the assembly is one of its own, and nothing is used twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.tiling.lattice import Faces, checked_mask, face_presence


def _numbered(there: NDArray[np.bool_]) -> NDArray[np.int32]:
    numbers = np.full(there.shape[::-1], -1, np.int32)
    stored = there.transpose(2, 1, 0)
    numbers[stored] = np.arange(np.count_nonzero(there), dtype=np.int32)
    return np.ascontiguousarray(numbers.transpose(2, 1, 0))


def tile_fresh(mask: ArrayLike, *, periodic: bool = False) -> tuple[NDArray[np.int32], Faces]:
    """Number cells and faces consecutively in raster order, x fastest.

    Parameters
    ----------
    mask : (nx, ny, nz) bool
        Cells to be filled.
    periodic : bool
        Whether the last plane of faces of each axis is the first one again.

    Returns
    -------
    interior : (nx, ny, nz) int32
        0..(number of cells)-1; -1 where there is no cell.
    faces : three int32 arrays
        For each axis its own numbers 0..(number of faces across this axis)-1, planes that are one counted once; shape
        n_a + 1 along axis a; -1 where there is no cell on either side.
    """
    cells = checked_mask(mask)
    faces = []
    for axis, there in enumerate(face_presence(cells, periodic)):
        if periodic:
            low = np.take(there, range(cells.shape[axis]), axis)
            numbers = _numbered(low)
            faces.append(np.concatenate([numbers, np.take(numbers, [0], axis)], axis))
        else:
            faces.append(_numbered(there))
    return _numbered(cells), (faces[0], faces[1], faces[2])
