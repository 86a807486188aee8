"""What all mesh formats share: the type of a mesh, and the checks before one is handed out or written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

__all__ = ["DecodedMesh", "as_written", "require_content", "require_faces", "require_room"]

DecodedMesh = tuple[NDArray[np.float64], NDArray[np.int64]]


def require_content(data: bytes | memoryview | bytearray, name: str) -> None:
    """Raise InputError for a file of no bytes."""
    if len(data) == 0:
        raise InputError(f"{name}: the file is empty", hint="was it fully written or downloaded?")


def require_room(name: str, what: str, claimed: int, bytes_each: int, left: int, position: int) -> None:
    """Raise InputError, before anything is allocated, if a header claims more than the rest of the file can hold."""
    if claimed * bytes_each > left:
        raise InputError(
            f"{name}: the header claims {claimed} {what}, which take at least {claimed * bytes_each} bytes, "
            f"but only {max(left, 0)} bytes follow byte {position}",
            hint="the file is cut off or its header is wrong: write or download it again",
        )


def require_faces(name: str, faces: NDArray[np.int64]) -> None:
    """Raise InputError for a mesh without a face."""
    if faces.shape[0] == 0:
        raise InputError(f"{name}: the file holds no faces", hint="a surface is needed, not points or lines alone")


def as_written(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.floating], NDArray[np.int32]]:
    """The arrays as the encoders want them: (n, 3) float32 or float64 and (m, 3) int32, C-contiguous.

    Raises
    ------
    ValueError
        If the shapes are wrong, a coordinate is not finite or a face names a vertex that does not exist.
    """
    points: NDArray[np.floating] = np.ascontiguousarray(vertices)
    if points.dtype != np.float32:
        points = points.astype(np.float64, copy=False)
    if points.ndim != 2 or points.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3:
        raise ValueError(f"a mesh is (n, 3) vertices and (m, 3) faces, not {vertices.shape} and {faces.shape}")
    if not np.isfinite(points).all():
        raise ValueError("the coordinates of a mesh must be finite")
    if faces.size and (faces.min() < 0 or faces.max() >= min(points.shape[0], 2**31)):
        raise ValueError(f"faces name vertices {faces.min()} to {faces.max()} of {points.shape[0]}")
    return points, np.ascontiguousarray(faces, np.int32)
