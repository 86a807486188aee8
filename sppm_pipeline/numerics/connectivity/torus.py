"""Label images of the connected components of a phase, on a box or on the torus."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.connectivity.components import find_components, paint_runs


def label(
    mask: NDArray[np.bool_] | NDArray[np.uint8],
    periodic: tuple[bool, bool, bool] = (True, True, True),
    connectivity: int = 6,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Number the connected components of a phase.

    Labels on the torus are the ones to use for a periodic cell: what looks like an island in the box may be held by
    the neighboring cell, and labels that do not wrap would reject nearly every cell of high porosity.

    Parameters
    ----------
    mask : (nz, ny, nx) bool or uint8
        The phase; anything but 0 belongs to it.
    periodic : 3 bools
        Whether opposite faces are merged, along x, y, z.
    connectivity : {6, 26}
        Neighbors across faces (for the solid), or across faces, edges and corners.

    Returns
    -------
    labels : (nz, ny, nx) int32
        0 outside the phase, else the number of the component from 1 on, by decreasing size, ties by the first voxel.
    sizes : (n,) int64
        Voxels of component 1, 2, ...
    """
    found = find_components(mask, periodic, connectivity)
    labels = np.zeros(found.runs.shape, dtype=np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, found.of_run + np.int32(1), labels)
    return labels, found.sizes
