"""NRRD images with their data attached, as scanners' software and image libraries write them; read by pynrrd.

The format: https://teem.sourceforge.net/nrrd/format.html. Data in a separate file are refused: what a header names
need not be what a user meant to open. Compressed data are unpacked here, within
bounds, as the library would unpack a small file to any size.
"""

from __future__ import annotations

import bz2
import io
import math
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.input_file import library, third_party_reader
from sppm_pipeline.services.formats.voxel_image import LARGEST_IMAGE, VoxelImage, checked_shape, raw_values

_LONGEST_HEADER = 1 << 20
_MAX_WIDTH = 8  # bytes of a voxel
_HINT = "the file was cut or damaged, or is of a kind that is not read; save it again with attached data (.nrrd)"


def decode(data: bytes, name: str) -> VoxelImage:
    """Read an image of three axes; the first axis of the file is x."""
    nrrd = library("nrrd", "images")
    head = io.BytesIO(data[:_LONGEST_HEADER])
    with third_party_reader("nrrd", name, _HINT):
        header = nrrd.read_header(head)
    if "data file" in header or "datafile" in header:
        raise InputError(f"{name} keeps its data in another file", hint="save it with attached data (.nrrd, not .nhdr)")
    if any(header.get(skip, 0) != 0 for skip in ("line skip", "lineskip", "byte skip", "byteskip")):
        raise InputError(f"{name}: a header that skips part of the data is not read", hint="save the image again")
    if header.get("endian", "little") not in ("little", "big"):
        raise InputError(f"{name}: endian is little or big, not {header['endian']!r}")
    with third_party_reader("nrrd", name, _HINT):
        shape = checked_shape(tuple(int(size) for size in header["sizes"]), 1, name)
    body = _unpacked(data[head.tell() :], header, min(_MAX_WIDTH * math.prod(shape), LARGEST_IMAGE), name)
    with third_party_reader("nrrd", name, _HINT):
        values = nrrd.read_data(header, io.BytesIO(body))
        spacing = _spacing(header, name)
    if header["encoding"] == "raw" and values.nbytes != len(body):
        raise InputError(f"{name}: {values.nbytes} bytes of data are announced, {len(body)} are there", hint=_HINT)
    return VoxelImage(values, spacing)


def encode(values: NDArray[Any], spacing: tuple[float, float, float] | None = None) -> Iterator[bytes]:
    """A file with raw data attached, piece by piece, of values (nx, ny, nz) of uint8 or float32; spacing in mm."""
    kind = {"uint8": "uint8", "float32": "float"}[values.dtype.name]
    lines = ["NRRD0004", f"type: {kind}", "dimension: 3", f"sizes: {' '.join(map(str, values.shape))}"]
    if spacing is not None:
        lines += [f"spacings: {' '.join(repr(float(edge)) for edge in spacing)}", 'units: "mm" "mm" "mm"']
    yield "\n".join([*lines, "encoding: raw", "endian: little", "", ""]).encode()
    yield from raw_values(values)


def _unpacked(data: bytes, header: dict[str, Any], limit: int, name: str) -> bytes:
    """The bytes of the voxels, at most one more than `limit`; the header then calls them raw."""
    encoding = header.get("encoding")
    try:
        if encoding in ("gzip", "gz"):
            data = zlib.decompressobj(31).decompress(data, limit + 1)
        elif encoding in ("bzip2", "bz2"):
            data = bz2.BZ2File(io.BytesIO(data)).read(limit + 1)
        elif encoding != "raw":
            return data
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{name}: the compressed data are damaged: {error}") from error
    header["encoding"] = "raw"
    return data


def _spacing(header: Mapping[str, Any], name: str) -> tuple[float, float, float] | None:
    if "spacings" in header:
        edges = np.asarray(header["spacings"], np.float64)
        if np.isnan(edges).any():  # so an axis without a spacing is written
            return None
    elif "space directions" in header:
        edges = np.linalg.norm(np.asarray(header["space directions"], np.float64), axis=1)
    else:
        return None
    if edges.shape != (3,) or not (np.isfinite(edges) & (edges > 0)).all():
        raise InputError(f"{name}: an image of three axes has three positive spacings, not {edges.tolist()}")
    return float(edges[0]), float(edges[1]), float(edges[2])
