"""VTK image data (.vti): a regular grid with arrays of values, in text, base64 or raw, packed by zlib or not.

The format: https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html. Files of one piece and of axes that are
not turned are read, which is what VTK and ParaView write for an image.
"""

from __future__ import annotations

import base64
import binascii
import zlib
from collections.abc import Iterator
from typing import Any, NoReturn
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.voxel_image import VoxelImage, checked_shape, raw_values

_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8",
}  # fmt: skip
_NAMES = {"uint8": "UInt8", "float32": "Float32"}
_HINT = "save the image again by ParaView or VTK, or as .nrrd, .tif or .npy"


class _Header:
    """Contents of the XML, without the raw data behind it, which are no XML."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.file: dict[str, str] = {}
        self.image: dict[str, str] = {}
        self.pieces: list[dict[str, str]] = []
        self.arrays: list[tuple[str, dict[str, str]]] = []
        self.texts: list[str] = []
        self.appended: dict[str, str] | None = None
        self._place, self._text = "", False

    def fail(self, what: str) -> NoReturn:
        raise InputError(f"{self.name}: {what}", hint=_HINT)

    def read(self, data: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.EntityDeclHandler = lambda *_: self.fail("entities are not read")
        parser.buffer_text = True
        end = data.find(b"<AppendedData")
        try:
            if end < 0:
                parser.Parse(data, True)
            else:
                close = data.find(b">", end) + 1
                parser.Parse(data[: close or len(data)], False)
        except expat.ExpatError as error:
            self.fail(f"this is no well-formed XML: {expat.ErrorString(error.code)} in line {error.lineno}")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        if tag == "VTKFile":
            self.file = attributes
        elif tag == "ImageData":
            self.image = attributes
        elif tag == "Piece":
            self.pieces.append(attributes)
        elif tag in ("PointData", "CellData", "FieldData"):
            self._place = tag
        elif tag == "DataArray" and self._place in ("PointData", "CellData"):
            self.arrays.append((self._place, attributes))
            self.texts.append("")
            self._text = True
        elif tag == "AppendedData":
            self.appended = attributes

    def _end(self, tag: str) -> None:
        if tag == "DataArray":
            self._text = False
        elif tag == self._place:
            self._place = ""

    def _characters(self, text: str) -> None:
        if self._text:
            self.texts[-1] += text

    def numbers(self, attributes: dict[str, str], key: str, count: int, default: str | None = None) -> list[float]:
        """An attribute of so many finite numbers."""
        text = attributes.get(key, default)
        try:
            values = [float(word) for word in (text or "").split()]
        except ValueError:
            values = []
        if len(values) != count or not np.isfinite(values).all():
            self.fail(f"{key} takes {count} numbers, got {str(text)[:60]!r}")
        return values


def decode(data: bytes, name: str, array: str | None = None) -> VoxelImage:
    """Read an array of numbers of a .vti file; values at points are taken as those of voxels around them.

    `name` is how to call the file in messages; `array` is needed if there are several of one component.
    """
    header = _Header(name)
    header.read(data)
    if header.file.get("type") != "ImageData" or len(header.pieces) != 1:
        header.fail(
            f"it holds {len(header.pieces)} piece(s) of {header.file.get('type', 'nothing')[:40]!r}, not an image"
        )
    turned = header.image.get("Direction")
    if turned is not None and header.numbers(header.image, "Direction", 9) != [1, 0, 0, 0, 1, 0, 0, 0, 1]:
        header.fail("its axes are turned by a Direction, which is not read")
    extent = [int(v) for v in header.numbers(header.pieces[0], "Extent", 6)]
    spacing = header.numbers(header.image, "Spacing", 3, "1 1 1")
    origin = header.numbers(header.image, "Origin", 3, "0 0 0")
    if min(spacing) <= 0:
        header.fail(f"the spacing {spacing} is not positive")
    number = _chosen(header, array)
    kind, about = header.arrays[number]
    points = [extent[2 * a + 1] - extent[2 * a] + (kind == "PointData") for a in range(3)]
    dtype = _dtype(header, about.get("type", ""))
    shape = checked_shape((points[0], points[1], points[2]), dtype.itemsize, name)
    values = _values(header, number, data, dtype, shape[0] * shape[1] * shape[2])
    shift = -0.5 if kind == "PointData" else 0.0
    low = tuple(origin[a] + (extent[2 * a] + shift) * spacing[a] for a in range(3))
    edges = (spacing[0], spacing[1], spacing[2])
    return VoxelImage(values.reshape(shape, order="F"), edges, (low[0], low[1], low[2]))


def _chosen(header: _Header, array: str | None) -> int:
    """The number of the array that is meant."""
    names = [about.get("Name", "") for _, about in header.arrays]
    if array is not None:
        if names.count(array) != 1:
            found = ", ".join(names)[:200] or "none"
            raise InputError(f"{header.name} has no single array {array[:60]!r}", hint=f"its arrays are {found}")
        number = names.index(array)
        if header.arrays[number][1].get("NumberOfComponents", "1") not in ("1", ""):
            header.fail(f"the array {array[:60]!r} has several components")
        return number
    plain = [i for i, (_, about) in enumerate(header.arrays) if about.get("NumberOfComponents", "1") in ("1", "")]
    if len(plain) != 1:
        found = ", ".join(names)[:200] or "none"
        raise InputError(
            f"{header.name} has {len(plain)} arrays of one component", hint=f"name one by `array`; there are {found}"
        )
    return plain[0]


def _dtype(header: _Header, kind: str) -> np.dtype[Any]:
    order = {"LittleEndian": "<", "BigEndian": ">"}.get(header.file.get("byte_order", "LittleEndian"))
    if kind not in _TYPES or order is None:
        header.fail(f"values of type {kind[:40]!r} in the byte order {header.file.get('byte_order')!r} are not read")
    return np.dtype(order + _TYPES[kind])


def _values(header: _Header, number: int, data: bytes, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
    """The values in the machine's byte order, (count,)."""
    about, text = header.arrays[number][1], header.texts[number]
    form = about.get("format")
    if form == "ascii":
        with np.errstate(all="ignore"):
            try:
                values = np.array(text.split(), np.float64).astype(dtype.newbyteorder("="))
            except (ValueError, OverflowError):
                header.fail("an array in text holds what is no number")
    else:
        encoded, packed = True, b""
        if form == "binary":
            packed = "".join(text.split()).encode("ascii", "replace")
        elif form == "appended" and header.appended is not None:
            start = data.find(b"_", data.find(b">", data.find(b"<AppendedData"))) + 1
            try:
                start += int(about.get("offset", "-1"))
            except ValueError:
                start = -1
            packed, encoded = data[start:] if 0 < start <= len(data) else b"", header.appended.get("encoding") != "raw"
            if encoded:
                packed = packed.partition(b"<")[0].strip()
        else:
            header.fail(f"an array in the format {str(form)[:40]!r} is not read")
        values = np.frombuffer(_block(header, packed, encoded, count * dtype.itemsize), dtype)
        values = values.astype(dtype.newbyteorder("="))
    if len(values) != count:
        header.fail(f"{count} values are announced, {len(values)} are there")
    return values


def _block(header: _Header, packed: bytes, encoded: bool, size: int) -> bytes:
    """The `size` bytes of an array, unpacked within bounds."""
    word = {"UInt32": 4, "UInt64": 8}.get(header.file.get("header_type", "UInt32"))
    if word is None:
        header.fail(f"the header type {header.file.get('header_type', '')[:40]!r} is not read")
    order: Any = "little" if header.file.get("byte_order", "LittleEndian") == "LittleEndian" else "big"

    def head(words: int) -> tuple[list[int], bytes]:
        """The first numbers, and what follows them; both are encoded apart."""
        length = words * word
        taken = -(-length // 3) * 4 if encoded else length
        raw = _decoded(header, packed[:taken]) if encoded else packed[:taken]
        if len(raw) < length:
            header.fail("an array is cut short")
        return [int.from_bytes(raw[i : i + word], order) for i in range(0, length, word)], packed[taken:]

    compressor = header.file.get("compressor")
    if compressor is None:
        length = word + size
        raw = _decoded(header, packed[: -(-length // 3) * 4]) if encoded else packed[:length]
        if len(raw) < length or int.from_bytes(raw[:word], order) != size:
            header.fail(f"an array of {size} bytes is announced, and is cut short or has another length")
        return raw[word:length]
    if compressor != "vtkZLibDataCompressor":
        header.fail(f"data packed by {compressor[:40]!r} are not read")
    (blocks, whole, last), _ = head(3)
    if blocks > size or (blocks - bool(last)) * whole + last != size:
        header.fail(f"packed blocks of {size} bytes are announced, and have another length")
    (_, _, _, *lengths), rest = head(3 + blocks)
    raw = _decoded(header, rest[: -(-sum(lengths) // 3) * 4]) if encoded else rest[: sum(lengths)]
    found, at = [], 0
    for i, length in enumerate(lengths):
        room = last if last and i == blocks - 1 else whole
        try:
            block = zlib.decompressobj().decompress(raw[at : at + length], room + 1)
        except zlib.error as error:
            header.fail(f"the packed data are damaged: {error}")
        if len(block) != room:
            header.fail("a packed block has another length than announced")
        found.append(block)
        at += length
    return b"".join(found)


def _decoded(header: _Header, text: bytes) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        header.fail("the base64 text of an array is damaged")


def encode(
    values: NDArray[Any], spacing: tuple[float, float, float], origin: tuple[float, float, float], array: str
) -> Iterator[bytes]:
    """The bytes of a .vti file with one value a voxel (cell data), raw appended data, piece by piece."""
    values = values.view(np.uint8) if values.dtype == bool else values
    kind = _NAMES[values.dtype.name]
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
