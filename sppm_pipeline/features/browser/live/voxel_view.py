"""Surfaces of voxels, in colors of their phases."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.grid import VOXEL_FACES

PHASE_COLORS = np.array(
    [(226, 216, 196), (0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (213, 94, 0)],
    np.uint8,
)
"""Bone, then colors that all kinds of color vision tell apart (Okabe and Ito 2008); phase 8 begins again."""


def phase_surface(
    phases: NDArray[np.uint8], spacing: tuple[float, float, float]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8]]:
    """Faces of voxels, `phases` (nx, ny, nz) with 0 for void and edges `spacing`, that border on void or on the
    outside.

    Returned are vertices (p, 3), triangles (n, 3) whose normals point outwards, and for each the color (n, 3) uint8 of
    the phase of the voxel behind it.
    """
    solid = np.pad(phases > 0, 1)
    inner = tuple(slice(1, -1) for _ in range(3))
    nodes = np.array(phases.shape) + 1
    triangles, colors = [], []
    for beyond, corners in VOXEL_FACES:
        bare = np.argwhere(solid[inner] & ~np.roll(solid, [-step for step in beyond], (0, 1, 2))[inner])
        ends = np.array([[c & 1, c >> 1 & 1, c >> 2] for c in corners])
        quads = np.ravel_multi_index(tuple(np.moveaxis(bare[:, None] + ends, 2, 0)), tuple(nodes))
        color = PHASE_COLORS[(phases[tuple(bare.T)].astype(np.int64) - 1) % len(PHASE_COLORS)]
        triangles += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
        colors += [color, color]
    used, faces = np.unique(np.concatenate(triangles), return_inverse=True)
    vertices = np.stack(np.unravel_index(used, tuple(nodes)), axis=1) * np.array(spacing)
    return vertices, faces.reshape(-1, 3), np.concatenate(colors)
