"""Images of voxels: what readers deliver, the checks they share, .npy in and out, and VTK image data out.

What reads the other kinds stands in `image_stack`, `nrrd` and `vti`.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.input_file import content_of

LARGEST_IMAGE = 2**33
"""Most bytes of an image in memory; a file that claims more is refused before anything is reserved."""


_CHUNK = 1 << 24
_VTK_TYPES = {"uint8": "UInt8", "float32": "Float32"}


class VoxelImage(NamedTuple):
    """An image as it stands in a file.

    Attributes
    ----------
    values : (nx, ny, nz)
        Any type of numbers, indexed x, y, z.
    spacing : (sx, sy, sz) or None
        Edges of a voxel in the unit of the file, where it says so.
    origin : (x, y, z) or None
        Low corner of the first voxel, where the file says so.
    """

    values: NDArray[Any]
    spacing: tuple[float, float, float] | None
    origin: tuple[float, float, float] | None = None


ENDINGS = (".npy", ".tif", ".tiff", ".nrrd", ".vti")


def read_image(path: Path, array: str | None = None) -> VoxelImage:
    """Read an image of any kind that is known, or a folder of pictures; `array` names one of several in a .vti file.

    Raises
    ------
    InputError
        If it can't be read.
    ResourceError
        If the library that reads it is not installed.
    """
    from sppm_pipeline.formats import image_stack, nrrd, vti

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


def decode_npy(data: bytes, name: str) -> VoxelImage:
    """Read a .npy file of a three-dimensional array of numbers, indexed x, y, z, without running what it may hide.

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
    step = max(1, _CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()


def raw_values(values: NDArray[Any]) -> Iterator[bytes]:
    """The values in little-endian order, x fastest, piece by piece."""
    flat = values.reshape(-1, order="F").astype(values.dtype.newbyteorder("<"), copy=False)
    step = max(1, _CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()


def encode_vti(
    values: NDArray[Any], spacing: tuple[float, float, float], origin: tuple[float, float, float], array: str
) -> Iterator[bytes]:
    """The bytes of a .vti file with one value a voxel (cell data), raw appended data, piece by piece.

    The format: https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
    """
    values = values.view(np.uint8) if values.dtype == bool else values
    kind = _VTK_TYPES[values.dtype.name]
    extent = " ".join(f"0 {n}" for n in values.shape)
    place = " ".join(repr(float(v)) for v in origin)
    steps = " ".join(repr(float(v)) for v in spacing)
    yield (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="ImageData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'  <ImageData WholeExtent="{extent}" Origin="{place}" Spacing="{steps}">\n'
        f'    <Piece Extent="{extent}">\n'
        f'      <CellData Scalars="{array}">\n'
        f'        <DataArray type="{kind}" Name="{array}" format="appended" offset="0"/>\n'
        "      </CellData>\n"
        "    </Piece>\n"
        "  </ImageData>\n"
        '  <AppendedData encoding="raw">\n_'
    ).encode()
    yield np.uint64(values.size * values.dtype.itemsize).astype("<u8").tobytes()
    yield from raw_values(values)
    yield b"\n  </AppendedData>\n</VTKFile>\n"
