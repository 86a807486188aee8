"""What readers of voxel images deliver, and the checks they share."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

LARGEST_IMAGE = 2**33
"""Most bytes of an image in memory; a file that claims more is refused before anything is reserved."""


class VoxelImage(NamedTuple):
    """An image as it stands in a file.

    Attributes
    ----------
    values : (nx, ny, nz)
        Any type of numbers, indexed x, y, z.
    spacing : (sx, sy, sz) or None
        Edges of a voxel in the unit of the file, where it says so.
    """

    values: NDArray[Any]
    spacing: tuple[float, float, float] | None


def checked_shape(shape: tuple[int, ...], itemsize: int, name: str) -> tuple[int, int, int]:
    """The shape, if it is one of a voxel image that can be held.

    Raises
    ------
    InputError
        If it has not three axes, an empty one, or more than `LARGEST_IMAGE` bytes.
    """
    if len(shape) != 3:
        raise InputError(f"{name} has {len(shape)} axes; a voxel image has 3")
    if min(shape) < 1:
        raise InputError(f"{name} is empty: its shape is {shape}")
    size = shape[0] * shape[1] * shape[2] * itemsize
    if size > LARGEST_IMAGE:
        raise InputError(
            f"{name} claims {shape[0]} x {shape[1]} x {shape[2]} voxels, {size / 2**30:.1f} GiB; the limit is "
            f"{LARGEST_IMAGE // 2**30} GiB",
            hint="cut out a smaller piece, or average voxels",
        )
    return shape[0], shape[1], shape[2]


def numbers(text: str, what: str, name: str, kind: type = float) -> list[Any]:
    """Numbers separated by blanks.

    Raises
    ------
    InputError
        If one is none, or not finite.
    """
    try:
        found = [kind(word) for word in text.split()]
    except ValueError:
        raise InputError(f"{name}: {what} should be numbers, got {text.strip()[:60]!r}") from None
    if not np.isfinite(np.array(found, np.float64)).all():
        raise InputError(f"{name}: {what} must be finite, got {text.strip()[:60]!r}")
    return found
