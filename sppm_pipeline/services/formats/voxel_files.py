"""Files of voxels of every kind that is known, by their endings; .npy is read and written here."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats import image_stack, nrrd, vti
from sppm_pipeline.services.formats.input_file import content_of
from sppm_pipeline.services.formats.voxel_image import CHUNK, LARGEST_IMAGE, VoxelImage, checked_shape

ENDINGS = (".npy", ".tif", ".tiff", ".nrrd", ".vti")


def read_image(path: Path, array: str | None = None) -> VoxelImage:
    """Read an image of any kind that is known, or a folder of pictures; `array` names one of several in a .vti file."""
    if path.is_dir():
        return image_stack.read_folder(path)
    ending = path.suffix.lower()
    if ending not in ENDINGS:
        hint = "PNG files are read as a folder of one picture a layer" if ending == ".png" else None
        raise InputError(f"{path.name} ends in {ending!r}; voxel images end in {', '.join(ENDINGS)}", hint=hint)
    data = content_of(path, LARGEST_IMAGE)
    if ending == ".vti":
        return vti.decode(data, path.name, array)
    decode = {".npy": decode_npy, ".nrrd": nrrd.decode}.get(ending, image_stack.decode_tiff)
    return decode(data, path.name)


def decode_npy(data: bytes, name: str) -> VoxelImage:
    """Read a .npy file of a three-dimensional array of numbers, indexed x, y, z, without running what it may hide."""
    stream = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream, max_header_size=10_000)
    except Exception as error:
        raise InputError(
            f"{name} is no .npy file: {(str(error).splitlines() or [type(error).__name__])[0][:120]}"
        ) from error
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


def encode_npy(values: NDArray[Any]) -> Iterator[bytes]:
    """The bytes of a .npy file with x fastest in memory, piece by piece."""
    head = io.BytesIO()
    header = {"descr": values.dtype.str, "fortran_order": True, "shape": values.shape}
    np.lib.format.write_array_header_1_0(head, header)
    yield head.getvalue()
    flat = values.reshape(-1, order="F")
    step = max(1, CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()
