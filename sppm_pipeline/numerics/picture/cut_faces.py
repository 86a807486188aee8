"""Which triangles of a surface were made by cutting the microstructure, so that a picture may tint them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grid import Grid

__all__ = ["cut_triangles"]


def cut_triangles(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    inner: NDArray[np.float32],
    outer: NDArray[np.float32] | None,
    grid: Grid,
) -> NDArray[np.bool_]:
    """Triangles on the border of the grid, and those where the domain's field, not the microstructure's, is zero.

    Parameters
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
        Surface of the larger of the two fields, capped at the border.
    inner : (nz, ny, nx) float32
        Field of the microstructure.
    outer : (nz, ny, nx) float32 or None
        Field of the domain.
    grid : Grid
        Where the fields were sampled.

    Returns
    -------
    (m,) bool
    """
    centre = vertices[faces].mean(1)
    place = (centre - grid.origin) / grid.spacing
    last = np.array(grid.shape) - 1
    cut: NDArray[np.bool_] = ((place < 1e-3) | (place > last - 1e-3)).any(1)
    if outer is not None:
        cut |= _at(outer, place, last) > _at(inner, place, last)
    return cut


def _at(field: NDArray[np.float32], place: NDArray[np.float64], last: NDArray[np.int64]) -> NDArray[np.float64]:
    """Trilinear interpolation at `place` (m, 3), in samples."""
    low = np.clip(np.floor(place).astype(np.int64), 0, last - 1)
    share = place - low
    total = np.zeros(len(place))
    for corner in range(8):
        offset = np.array([corner & 1, corner >> 1 & 1, corner >> 2])
        i, j, k = (low + offset).T
        total += np.where(offset, share, 1 - share).prod(1) * field[k, j, i]
    return total
