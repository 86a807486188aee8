"""Where a surface was made by cutting the microstructure, so that a picture may tint it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.grid import Grid

BORDER = 0.02
"""How far from the border of the grid, in samples, a surface counts as cut by it."""


def cut_values(
    vertices: NDArray[np.float64], inner: NDArray[np.float32], outer: NDArray[np.float32] | None, grid: Grid
) -> NDArray[np.float64]:
    """A value at each vertex that is positive where the surface is a cut; its zero line is the rim of the cut.

    A cut lies on the border of the grid, or where the domain's field is zero and not that of the microstructure.

    Parameters
    ----------
    vertices : (n, 3) float64
        Of the surface of the larger of the two fields, capped at the border.
    inner : (nz, ny, nx) float32
        Field of the microstructure.
    outer : (nz, ny, nx) float32 or None
        Field of the domain.
    grid : Grid
        Where the fields were sampled.

    Returns
    -------
    (n,) float64
    """
    place = (vertices - grid.origin) / grid.spacing
    last = np.array(grid.shape) - 1
    value: NDArray[np.float64] = BORDER - np.minimum(place, last - place).min(1)
    if outer is not None:
        value = np.maximum(value, _at(outer, place, last) - _at(inner, place, last))
    return value


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
