"""NumPy arrays, read without ever running what a file may hide."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.voxel_image import VoxelImage, checked_shape

_CHUNK = 1 << 24


def decode(data: bytes, name: str) -> VoxelImage:
    """Read a .npy file of a three-dimensional array of numbers, indexed x, y, z.

    Raises
    ------
    InputError
        If the file is no such array, is cut, or holds objects.
    """
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream, max_header_size=10_000)
    except Exception as error:
        raise InputError(f"{name} is no .npy file: {_first_line(error)}") from error
    if dtype.kind not in "buif" or dtype.subdtype is not None:
        raise InputError(f"{name} holds {dtype}; a voxel image holds booleans, integers or real numbers")
    wanted = checked_shape(shape, dtype.itemsize, name)
    count, start = wanted[0] * wanted[1] * wanted[2], stream.tell()
    if len(data) - start != count * dtype.itemsize:
        raise InputError(
            f"{name} claims {count} voxels of {dtype.itemsize} bytes, but {len(data) - start} bytes follow its header",
            hint="the file was cut or damaged; copy it again",
        )
    values = np.frombuffer(data, dtype, count, start).reshape(wanted, order="F" if fortran else "C")
    return VoxelImage(values, None)


def encode(values: NDArray[Any]) -> Iterator[bytes]:
    """The bytes of a .npy file with x fastest in memory, piece by piece."""
    head = io.BytesIO()
    header = {"descr": values.dtype.str, "fortran_order": True, "shape": values.shape}
    np.lib.format.write_array_header_1_0(head, header)
    yield head.getvalue()
    flat = values.reshape(-1, order="F")
    step = max(1, _CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0][:120]
