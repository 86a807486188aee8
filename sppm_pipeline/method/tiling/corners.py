"""Corner colors: lattice corners are colored, and what lies between them follows.

A face is named by its four corners and an interior by its eight, so the four cells around a lattice edge always agree
about that edge, which face colors alone can't promise (Lagae and Dutre 2006, "An alternative for Wang tiles: colored
edges versus colored corners"). Corners are drawn freely by a hash of their place, so nothing can get stuck.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.tiling.lattice import (
    CORNER,
    INTERIOR,
    Laid,
    check_count,
    checked_mask,
    face_presence,
    hash_places,
)
from sppm_pipeline.services.arrays import I32

_MAX_COLORS_OF_FACES = 215  # 215^4 < 2^31
_MAX_COLORS_OF_CELLS = 14  # 14^8 < 2^31


def _combined(corners: I32, colors: int, axes: tuple[int, ...]) -> I32:
    """Number each place by the corners at both ends of `axes`; each of these axes gets one shorter."""
    number = corners.astype(np.int64)
    base = colors
    for axis in axes:
        low = np.take(number, range(number.shape[axis] - 1), axis)
        high = np.take(number, range(1, number.shape[axis]), axis)
        number = low + base * high
        # a number of two ends has twice as many digits
        base *= base
    return number.astype(np.int32)


def tile_corners(
    mask: ArrayLike, seed: int, colors: int, interiors: int | None = None, *, periodic: bool = False
) -> Laid:
    """Fill cells by coloring the corners of the lattice.

    Parameters
    ----------
    mask : (nx, ny, nz) bool
        Cells to be filled.
    seed : int
        Same seed, same tiling.
    colors : int
        Number of corner colors c.
    interiors : int, optional
        Number of interiors, drawn for each cell. Without it the eight corners name the interior (c^8 interiors).
    periodic : bool
        Whether the assembly repeats.

    Returns
    -------
    interior : (nx, ny, nz) int32
        0..interiors-1 or 0..c^8-1; -1 where there is no cell.
    faces : three int32 arrays
        0..c^4-1; shape n_a + 1 along axis a; -1 where there is no cell on either side.

    Digit n in base c of a number is the color of the corner at position n: bit b of n says whether that corner lies at
    the high end of the b-th axis, for interiors of x, y, z, for faces of those in which the face extends.

    Raises
    ------
    DesignError
        If there are too many colors to number the interiors (more than 14, without `interiors`) or the faces (more
        than 215), or fewer than one color or interior.
    """
    check_count("corner colors", colors, _MAX_COLORS_OF_FACES if interiors is not None else _MAX_COLORS_OF_CELLS)
    cells = checked_mask(mask)
    nx, ny, nz = cells.shape
    i, j, k = np.ogrid[: nx + 1, : ny + 1, : nz + 1]
    if periodic:
        i, j, k = i % nx, j % ny, k % nz
    corners = (hash_places(seed, CORNER, i, j, k) % np.uint64(colors)).astype(np.int32)
    if interiors is None:
        # corner cubes of Lagae and Dutre: the content follows from the eight corners
        inside = _combined(corners, colors, (0, 1, 2))
    else:
        check_count("interiors", interiors)
        i, j, k = np.ogrid[:nx, :ny, :nz]
        inside = (hash_places(seed, INTERIOR, i, j, k) % np.uint64(interiors)).astype(np.int32)
    interior = np.where(cells, inside, np.int32(-1))
    x, y, z = (
        np.where(there, _combined(corners, colors, across), np.int32(-1))
        for there, across in zip(face_presence(cells, periodic), ((1, 2), (0, 2), (0, 1)), strict=True)
    )
    return interior, (x, y, z)
