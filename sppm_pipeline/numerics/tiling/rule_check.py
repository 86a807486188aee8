"""Counting broken adjacencies of a tiling: an independent judge of every tiler."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.tiling.lattice import Faces, face_presence


def _checked_tiles(tiles: ArrayLike, tile_faces: ArrayLike) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    placed, colors = np.asarray(tiles, np.int64), np.asarray(tile_faces, np.int64)
    if colors.ndim != 2 or colors.shape[1] not in (3, 6):
        raise ValueError(f"face colors of tiles must have shape (n, 3) or (n, 6), got {colors.shape}")
    if placed.max(initial=-1) >= len(colors) or placed.min(initial=0) < -1:
        raise ValueError(f"tiles must be within -1..{len(colors) - 1}")
    if colors.shape[1] == 3:
        colors = np.repeat(colors, 2, axis=1)
    return placed, colors


def rule1_violations(tiles: ArrayLike, tile_faces: ArrayLike, *, periodic: bool = False) -> NDArray[np.int64]:
    """Count neighbors whose touching faces show different colors (Rule 1 of the paper).

    Parameters
    ----------
    tiles : (nx, ny, nz) int
        Tile of each cell, -1 where there is none.
    tile_faces : (n, 3) or (n, 6) int
        Colors of each tile: across x, y, z if opposite faces are equal, else low x, high x, low y, high y, low z,
        high z.
    periodic : bool
        Whether the assembly repeats.

    Returns
    -------
    (3,) int64
        Broken adjacencies along x, y, z.

    Raises
    ------
    ValueError
        If `tile_faces` has another shape or a tile isn't among its rows.
    """
    placed, colors = _checked_tiles(tiles, tile_faces)
    broken = np.zeros(3, np.int64)
    for axis in range(3):
        cells = np.moveaxis(placed, axis, 0)
        low, high = (cells, np.roll(cells, -1, axis=0)) if periodic else (cells[:-1], cells[1:])
        both = (low >= 0) & (high >= 0)
        broken[axis] = np.count_nonzero(colors[low[both], 2 * axis + 1] != colors[high[both], 2 * axis])
    return broken


def face_violations(
    interior: ArrayLike, faces: Faces, tile_faces: ArrayLike | None = None, *, periodic: bool = False
) -> NDArray[np.int64]:
    """Count faces that don't fit the cells.

    A face is broken if it lies at a cell and has no color, has a color and lies at no cell, shows another color
    than a tile beside it (once for each such tile), or differs from the face at the opposite end of a periodic
    assembly.

    Parameters
    ----------
    interior : (nx, ny, nz) int
        Content of each cell, -1 where there is none.
    faces : three int arrays
        Shape n_a + 1 along axis a, -1 where there is no face.
    tile_faces : (n, 3) or (n, 6) int, optional
        Colors of each tile as for `rule1_violations`, where `interior` numbers tiles whose faces are fixed.
    periodic : bool
        Whether the assembly repeats.

    Returns
    -------
    (3,) int64
        Broken faces across x, y, z.

    Raises
    ------
    ValueError
        If a face array has the wrong shape, `tile_faces` has, or a tile isn't among its rows.
    """
    cells = np.asarray(interior)
    broken = np.zeros(3, np.int64)
    for axis, there in enumerate(face_presence(cells >= 0, periodic)):
        if faces[axis].shape != there.shape:
            raise ValueError(f"faces across axis {axis} must have shape {there.shape}, got {faces[axis].shape}")
        broken[axis] = np.count_nonzero((faces[axis] >= 0) != there)
        planes = np.moveaxis(faces[axis], axis, 0)
        if periodic:
            broken[axis] += np.count_nonzero(planes[0] != planes[-1])
        if tile_faces is not None:
            placed, colors = _checked_tiles(interior, tile_faces)
            along = np.moveaxis(placed, axis, 0)
            filled = along >= 0
            broken[axis] += np.count_nonzero(colors[along[filled], 2 * axis] != planes[:-1][filled])
            broken[axis] += np.count_nonzero(colors[along[filled], 2 * axis + 1] != planes[1:][filled])
    return broken
