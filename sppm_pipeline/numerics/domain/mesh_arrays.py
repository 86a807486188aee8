"""Meshes in the types that the kernels are compiled for."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import InputError


def as_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A mesh in the types that the kernels are compiled for.

    Parameters
    ----------
    vertices : (n, 3) floats
    faces : (m, 3) integers
        Indices of vertices.

    Returns
    -------
    vertices : (n, 3) float64, C-contiguous
    faces : (m, 3) int32, C-contiguous

    Raises
    ------
    InputError
        If a coordinate is not finite or an index names no vertex.
    ValueError
        If the shapes are wrong.
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    raw = np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "iu":
        raise ValueError(f"a mesh is (n, 3) floats and (m, 3) integers, not {points.shape} and {raw.shape} {raw.dtype}")
    if not np.isfinite(points).all():
        bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
        raise InputError(f"{bad} of {len(points)} vertices have a coordinate that is not finite")
    if raw.size and (int(raw.min()) < 0 or int(raw.max()) >= len(points)):
        raise InputError(f"faces name vertices {raw.min()} to {raw.max()}, the mesh has {len(points)}")
    return points, np.ascontiguousarray(raw, dtype=np.int32)
