"""NRRD images with their data attached, as scanners' software and image libraries write them.

The format: https://teem.sourceforge.net/nrrd/format.html. Data in a separate file are refused: what a header names
need not be what a user meant to open.
"""

from __future__ import annotations

import bz2
import io
import re
import zlib

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.voxel_image import VoxelImage, checked_shape, numbers

TYPES = {
    "int8": ("signed char", "int8_t"),
    "uint8": ("uchar", "unsigned char", "uint8_t"),
    "int16": ("short", "short int", "signed short", "signed short int", "int16_t"),
    "uint16": ("ushort", "unsigned short", "unsigned short int", "uint16_t"),
    "int32": ("int", "signed int", "int32_t"),
    "uint32": ("uint", "unsigned int", "uint32_t"),
    "int64": ("longlong", "long long", "long long int", "signed long long", "signed long long int", "int64_t"),
    "uint64": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64_t"),
    "float32": ("float",),
    "float64": ("double",),
}

_LONGEST_HEADER = 1 << 20


def decode(data: bytes, name: str) -> VoxelImage:
    """Read an image of three axes; the first axis of the file is x.

    Raises
    ------
    InputError
        If the header contradicts itself or the data, or is of a kind that is not read.
    """
    end = re.search(rb"\r?\n\r?\n", data[:_LONGEST_HEADER])
    if not data.startswith(b"NRRD000") or end is None:
        raise InputError(
            f"{name} is no NRRD image: it should begin with NRRD000 and a header that ends in a blank line"
        )
    fields = _fields(data[: end.start()], name)
    if "data file" in fields or "datafile" in fields:
        raise InputError(f"{name} keeps its data in another file", hint="save it with attached data (.nrrd, not .nhdr)")
    for skip in ("line skip", "lineskip", "byte skip", "byteskip"):
        if fields.get(skip, "0").strip() != "0":
            raise InputError(f"{name}: a header that skips part of the data is not read", hint="save the image again")
    dtype = _dtype(fields, name)
    sizes = numbers(_field(fields, "sizes", name), "the sizes", name, int)
    if str(len(sizes)) != _field(fields, "dimension", name).strip():
        raise InputError(f"{name}: {len(sizes)} sizes do not fit the dimension {fields['dimension'].strip()}")
    shape = checked_shape(tuple(sizes), dtype.itemsize, name)
    size = shape[0] * shape[1] * shape[2] * dtype.itemsize
    body = _body(data[end.end() :], fields.get("encoding", "raw").strip().lower(), size, shape, dtype, name)
    if len(body) != size:
        raise InputError(
            f"{name}: {size} bytes of data are announced, {'more' if len(body) > size else len(body)} are there",
            hint="the file was cut or damaged; copy it again",
        )
    return VoxelImage(np.frombuffer(body, dtype).reshape(shape, order="F"), _spacing(fields, name))


def _fields(head: bytes, name: str) -> dict[str, str]:
    fields = {}
    for number, line in enumerate(head.decode("utf-8", "replace").splitlines()[1:], 2):
        if line.startswith("#") or ":=" in line or not line.strip():
            continue
        key, colon, value = line.partition(":")
        if not colon:
            raise InputError(f"{name}:{number}: a line of the header should read `field: value`, got {line[:60]!r}")
        fields[key.strip().lower()] = value
    return fields


def _field(fields: dict[str, str], key: str, name: str) -> str:
    if key not in fields:
        raise InputError(f"{name}: the header lacks the field {key!r}")
    return fields[key]


def _dtype(fields: dict[str, str], name: str) -> np.dtype[np.generic]:
    word = _field(fields, "type", name).strip().lower()
    for kind, words in TYPES.items():
        if word == kind or word in words:
            endian = fields.get("endian", "little").strip().lower()
            if endian not in ("little", "big"):
                raise InputError(f"{name}: endian is little or big, got {endian!r}")
            return np.dtype(kind).newbyteorder("<" if endian == "little" else ">")
    raise InputError(f"{name}: voxels of type {word!r} are not read; known are {', '.join(TYPES)}")


def _body(
    data: bytes, encoding: str, size: int, shape: tuple[int, int, int], dtype: np.dtype[np.generic], name: str
) -> bytes:
    """The voxels' bytes, at most one more than wanted, whatever a compressed stream expands to."""
    try:
        if encoding == "raw":
            return data
        if encoding in ("gzip", "gz"):
            return zlib.decompressobj(31).decompress(data, size + 1)
        if encoding in ("bzip2", "bz2"):
            return bz2.BZ2File(io.BytesIO(data)).read(size + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{name}: the compressed data are damaged: {error}") from error
    if encoding in ("ascii", "text", "txt"):
        # each number takes at least two characters
        if len(data) + 1 < 2 * shape[0] * shape[1] * shape[2]:
            return data[:0]
        return np.array(numbers(data.decode("ascii", "replace"), "the data", name), np.float64).astype(dtype).tobytes()
    raise InputError(f"{name}: the encoding {encoding!r} is not read; known are raw, gzip, bzip2 and ascii")


def _spacing(fields: dict[str, str], name: str) -> tuple[float, float, float] | None:
    if "spacings" in fields:
        found = fields["spacings"].split()
        if any(word.lower() == "nan" for word in found):
            return None
        edges = numbers(fields["spacings"], "the spacings", name)
    elif "space directions" in fields:
        vectors = [
            numbers(part.replace(",", " "), "a space direction", name)
            for part in re.findall(r"\(([^)]*)\)", fields["space directions"])
        ]
        edges = [float(np.linalg.norm(vector)) for vector in vectors]
    else:
        return None
    if len(edges) != 3 or not min(edges) > 0:
        raise InputError(f"{name}: an image of three axes has three positive spacings, got {edges}")
    return edges[0], edges[1], edges[2]
