"""What all mesh formats share: the type of a mesh, and the checks before one is handed out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

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
