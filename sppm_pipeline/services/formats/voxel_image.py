"""Images of voxels: what the readers of all kinds of files deliver, and what they share."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from numpy.typing import NDArray

from sppm_pipeline.errors import InputError

LARGEST_IMAGE = 2**33
"""Most bytes of an image in memory; a file that claims more is refused before anything is reserved."""

CHUNK = 1 << 24
"""Most bytes that a writer hands on at once."""


class VoxelImage(NamedTuple):
    """An image as it stands in a file."""

    values: NDArray[Any]  # any type of numbers, indexed x, y, z
    spacing: tuple[float, float, float] | None  # edges of a voxel in the unit of the file, where it says so
    origin: tuple[float, float, float] | None = None  # low corner of the first voxel, where the file says so


def checked_shape(shape: tuple[int, ...], itemsize: int, name: str) -> tuple[int, int, int]:
    """The shape, if it is one of a voxel image that can be held: three axes, not empty, up to `LARGEST_IMAGE` bytes."""
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


def raw_values(values: NDArray[Any]) -> Iterator[bytes]:
    """The values in little-endian order, x fastest, piece by piece."""
    flat = values.reshape(-1, order="F").astype(values.dtype.newbyteorder("<"), copy=False)
    step = max(1, CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()
