"""Free face colors: every face and every interior is drawn on its own by a hash of its place.

With contents factorized into interiors, faces and connectors, opposite faces of a cell may differ at no cost, so any
assignment of colors is a valid tiling: K interiors and c colors combine to K c^6 cells. The hash gives any cell of
an assembly of any size without looking at the others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.method.tiling.lattice import (
    FACE,
    INTERIOR,
    Laid,
    check_count,
    checked_mask,
    face_presence,
    hash_places,
)


def tile_hashed(mask: ArrayLike, seed: int, interiors: int, colors: int, *, periodic: bool = False) -> Laid:
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
        0..K-1; -1 where there is no cell.
    faces : three int32 arrays
        0..c-1; shape n_a + 1 along axis a; -1 where there is no cell on either side.

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
    # a hash of the place alone, so that any cell is known without its neighbors
    drawn = hash_places(seed, INTERIOR, i, j, k) % np.uint64(interiors)
    interior = np.where(cells, drawn.astype(np.int32), np.int32(-1))
    faces = []
    for axis, there in enumerate(face_presence(cells, periodic)):
        indices = list(np.ogrid[tuple(slice(n) for n in there.shape)])
        if periodic:
            # the last plane is drawn as the first one, to which it is glued
            indices[axis] = indices[axis] % cells.shape[axis]
        drawn = hash_places(seed, FACE + axis, indices[0], indices[1], indices[2]) % np.uint64(colors)
        faces.append(np.where(there, drawn.astype(np.int32), np.int32(-1)))
    return interior, (faces[0], faces[1], faces[2])
