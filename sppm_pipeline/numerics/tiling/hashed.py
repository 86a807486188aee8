"""Free face colors: every face and every interior is drawn on its own by a hash of its place.

With contents factorized into interiors, faces and connectors, opposite faces of a cell may differ at no cost, so any
assignment of colors is a valid tiling: K interiors and c colors combine to K c^6 cells. The hash gives any cell of
an assembly of any size without looking at the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.tiling.hashing import FACE, INTERIOR, hash_places
from sppm_pipeline.numerics.tiling.lattice import Faces, check_count, checked_mask, face_presence


def interior_at(seed: int, cells: ArrayLike, interiors: int) -> NDArray[np.int32]:
    """Interior of any cell.

    Parameters
    ----------
    seed : int
        Same seed, same tiling.
    cells : (..., 3) int
        Indices of cells, negative ones included.
    interiors : int
        Number of interiors K.

    Returns
    -------
    (...) int32
        Interiors 0..K-1.

    Raises
    ------
    DesignError
        If K is below 1.
    """
    check_count("interiors", interiors)
    places = np.asarray(cells, np.int64)
    drawn = hash_places(seed, INTERIOR, places[..., 0], places[..., 1], places[..., 2])
    return (drawn % np.uint64(interiors)).astype(np.int32).reshape(places.shape[:-1])


def face_at(
    seed: int, axis: int, faces: ArrayLike, colors: int, period: tuple[int, int, int] | None = None
) -> NDArray[np.int32]:
    """Color of any face.

    Parameters
    ----------
    seed : int
        Same seed, same tiling.
    axis : int
        Axis across which the face lies: 0, 1, 2 for x, y, z.
    faces : (..., 3) int
        Face (i, j, k) is the low side of cell (i, j, k) along `axis`; its high side is the low side of the next cell.
    colors : int
        Number of colors c.
    period : (nx, ny, nz), optional
        Number of cells after which the assembly repeats.

    Returns
    -------
    (...) int32
        Colors 0..c-1.

    Raises
    ------
    DesignError
        If c is below 1.
    """
    check_count("face colors", colors)
    places = np.asarray(faces, np.int64)
    if period is not None:
        places = places % np.asarray(period, np.int64)
    drawn = hash_places(seed, FACE + axis, places[..., 0], places[..., 1], places[..., 2])
    return (drawn % np.uint64(colors)).astype(np.int32).reshape(places.shape[:-1])


def tile_hashed(
    mask: ArrayLike, seed: int, interiors: int, colors: int, *, periodic: bool = False
) -> tuple[NDArray[np.int32], Faces]:
    """Fill cells with interiors and face colors that are drawn independently of each other.

    Parameters
    ----------
    mask : (nx, ny, nz) bool
        Cells to be filled.
    seed : int
        Same seed, same tiling.
    interiors, colors : int
        Number of interiors K and of colors c of each axis.
    periodic : bool
        Whether the last plane of faces of each axis is the first one again.

    Returns
    -------
    interior : (nx, ny, nz) int32
        0..K-1 as `interior_at` gives them; -1 where there is no cell.
    faces : three int32 arrays
        0..c-1 as `face_at` gives them; shape n_a + 1 along axis a; -1 where there is no cell on either side.

    Raises
    ------
    DesignError
        If `interiors` or `colors` is below 1.
    """
    check_count("interiors", interiors)
    check_count("face colors", colors)
    cells = checked_mask(mask)
    nx, ny, nz = cells.shape
    i, j, k = np.ogrid[:nx, :ny, :nz]
    drawn = hash_places(seed, INTERIOR, i, j, k) % np.uint64(interiors)
    interior = np.where(cells, drawn.astype(np.int32), np.int32(-1))
    faces = []
    for axis, there in enumerate(face_presence(cells, periodic)):
        indices = list(np.ogrid[tuple(slice(n) for n in there.shape)])
        if periodic:
            indices[axis] = indices[axis] % cells.shape[axis]
        drawn = hash_places(seed, FACE + axis, indices[0], indices[1], indices[2]) % np.uint64(colors)
        faces.append(np.where(there, drawn.astype(np.int32), np.int32(-1)))
    return interior, (faces[0], faces[1], faces[2])
