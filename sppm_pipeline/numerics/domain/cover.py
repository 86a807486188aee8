"""Which cells of a lattice a part needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.domain.inside import inside_layers, prepare_inside, way_for
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.numerics.meshcheck.orientation import orient


def cells_touched(
    vertices: ArrayLike,
    faces: ArrayLike,
    origin: NDArray[np.float64],
    edge: float,
    shape: tuple[int, int, int],
    closed: bool = True,
) -> NDArray[np.bool_]:
    """The cells that contain a piece of the part: those met by the box of a triangle, and those inside.

    A cell met only by the box of a triangle, not by the triangle, may be listed in vain; none is left out.

    Parameters
    ----------
    vertices : (n, 3) floats
    faces : (m, 3) integers
        Wound outwards, if they bound a solid; others are turned first.
    origin : (3,) float64
        Low corner of cell (0, 0, 0).
    edge : float
    shape : tuple of 3 ints
    closed : bool
        Whether the mesh bounds a solid (`EdgeCounts.bounds_solid`).

    Returns
    -------
    (nx, ny, nz) bool
    """
    points = np.ascontiguousarray(vertices, np.float64)
    if not closed:
        faces = orient(points, np.asarray(faces, np.int32)).faces
    # a cell that no triangle touches lies wholly inside or outside, so its center decides; but where a mesh is open,
    # the border of the inside runs through cells without a triangle
    n = 1 if closed else 4
    (nx, ny, nz), h = (n * s for s in shape), edge / n
    x, y, z = (float(o) + h / 2 for o in origin)
    samples = Grid((x, y, z), (h, h, h), (nx, ny, nz))
    found = inside_layers(prepare_inside(points, faces, samples, way_for(closed)), 0, nz).mask.transpose(2, 1, 0)
    inside = found.reshape(shape[0], n, shape[1], n, shape[2], n).any(axis=(1, 3, 5))
    touched = np.zeros(shape, np.bool_)
    _touch(points[np.asarray(faces, np.int64)], np.asarray(origin, np.float64), edge, touched)
    touched |= inside
    return touched


@jit
def _touch(
    triangles: NDArray[np.float64], origin: NDArray[np.float64], edge: float, touched: NDArray[np.bool_]
) -> None:
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(triangles.shape[0]):
        for a in range(3):
            least = min(triangles[f, 0, a], triangles[f, 1, a], triangles[f, 2, a])
            most = max(triangles[f, 0, a], triangles[f, 1, a], triangles[f, 2, a])
            low[a] = min(max(np.int64(np.floor((least - origin[a]) / edge)), 0), touched.shape[a] - 1)
            high[a] = min(max(np.int64(np.floor((most - origin[a]) / edge)), 0), touched.shape[a] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    touched[i, j, k] = True
