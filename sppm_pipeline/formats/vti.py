"""VTK image data (.vti), as ParaView and simulation codes read and write them.

The format: https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from collections.abc import Iterator
from typing import Any, Literal
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.voxel_image import VoxelImage, checked_shape, numbers

TYPES = {f"{kind}{bits}": f"{kind.lower()}{bits}" for kind in ("Int", "UInt") for bits in (8, 16, 32, 64)}
TYPES |= {"Float32": "float32", "Float64": "float64"}

_CHUNK = 1 << 24
_DEEPEST = 32

Element = tuple[str, dict[str, str], list[str]]


def encode(
    values: NDArray[Any], spacing: tuple[float, float, float], origin: tuple[float, float, float], array: str
) -> Iterator[bytes]:
    """The bytes of a .vti file with one value a voxel, raw appended data, piece by piece."""
    values = values.view(np.uint8) if values.dtype == bool else values
    kind = next(name for name, dtype in TYPES.items() if dtype == values.dtype.name)
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
    flat = values.reshape(-1, order="F").astype(values.dtype.newbyteorder("<"), copy=False)
    step = max(1, _CHUNK // values.dtype.itemsize)
    for start in range(0, flat.size, step):
        yield flat[start : start + step].tobytes()
    yield b"\n  </AppendedData>\n</VTKFile>\n"


def decode(data: bytes, name: str, array: str | None = None) -> VoxelImage:
    """Read an image with one value a voxel (cell data), or a point (point data).

    Parameters
    ----------
    array : str, optional
        Name of the array; the only one, or the one marked as scalars, if omitted.

    Raises
    ------
    InputError
        If the file is damaged, contradicts itself, or holds several arrays and none is named.
    """
    head, appended, coded = _split(data, name)
    elements = _elements(head, name)
    top = _one(elements, "VTKFile", name)[1]
    if top.get("type") != "ImageData":
        raise InputError(f"{name} holds {top.get('type')!r}; only ImageData are voxel images")
    order: Literal["<", ">"] = "<" if top.get("byte_order", "LittleEndian") == "LittleEndian" else ">"
    words = np.dtype("uint64" if top.get("header_type") == "UInt64" else "uint32").newbyteorder(order)
    piece = _one(elements, "Piece", name)[1]
    extent = numbers(piece.get("Extent", ""), "the extent", name, int)
    if len(extent) != 6:
        raise InputError(f"{name}: an extent has six numbers, got {extent}")
    cells = tuple(extent[2 * axis + 1] - extent[2 * axis] for axis in range(3))
    image = _one(elements, "ImageData", name)[1]
    spacing = numbers(image.get("Spacing", "1 1 1"), "the spacing", name)
    if len(spacing) != 3 or not min(spacing) > 0:
        raise InputError(f"{name}: the spacing is three positive numbers, got {image.get('Spacing')!r}")
    attributes, text, points = _chosen(elements, array, name)
    if attributes.get("NumberOfComponents", "1").strip() != "1":
        raise InputError(f"{name}: the array {attributes.get('Name')!r} has several components; a voxel image has one")
    if attributes.get("type") not in TYPES:
        raise InputError(
            f"{name}: values of type {attributes.get('type')!r} are not read; known are {', '.join(TYPES)}"
        )
    dtype = np.dtype(TYPES[attributes["type"]]).newbyteorder(order)
    shape = checked_shape(tuple(n + points for n in cells), dtype.itemsize, name)
    size = shape[0] * shape[1] * shape[2] * dtype.itemsize
    form = attributes.get("format", "ascii")
    if form == "ascii":
        flat = np.array(numbers(text, "the data", name), np.float64)
        raw = flat.astype(dtype).tobytes()
    else:
        source, encoded = text.encode("ascii", "replace").strip(), True
        if form == "appended":
            offset = numbers(attributes.get("offset", ""), "the offset", name, int)
            if len(offset) != 1 or not 0 <= offset[0] < len(appended):
                raise InputError(f"{name}: the array begins outside of the appended data")
            source, encoded = appended[offset[0] :], coded
        raw = _unpacked(source, encoded, "compressor" in top, words, size, top.get("compressor", ""), name)
    if len(raw) != size:
        raise InputError(
            f"{name}: {size} bytes of data are announced, {len(raw)} are there",
            hint="the file was cut or damaged; copy it again",
        )
    return VoxelImage(np.frombuffer(raw, dtype).reshape(shape, order="F"), (spacing[0], spacing[1], spacing[2]))


def _split(data: bytes, name: str) -> tuple[bytes, bytes, bool]:
    """The XML without the appended data, those data, and whether they are written in base 64."""
    begin = re.search(rb"<AppendedData([^>]*)>\s*_", data)
    if begin is None:
        return data, b"", False
    if (end := data.rfind(b"</AppendedData>")) < begin.end():
        raise InputError(f"{name}: the appended data have no end", hint="the file was cut; copy it again")
    coded = b"base64" in begin.group(1)
    return data[: begin.end() - 1] + data[end:], data[begin.end() : end], coded


def _elements(text: bytes, name: str) -> list[Element]:
    """All elements in order with attributes and text; no entities, no document types, no depth."""
    found: list[Element] = []
    stack: list[Element] = []
    parser = expat.ParserCreate()
    parser.buffer_text = True

    def refuse(*_: object) -> None:
        raise InputError(f"{name}: a document type declaration has no place in VTK data")

    def start(tag: str, attributes: dict[str, str]) -> None:
        element: Element = (tag, attributes, [])
        if len(stack) >= _DEEPEST or len(found) > 100_000:
            raise InputError(f"{name} is nested too deeply, or has too many elements, for VTK data")
        found.append(element)
        stack.append(element)

    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: stack.pop()
    parser.CharacterDataHandler = lambda text: stack[-1][2].append(text) if stack else None
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise InputError(f"{name} is no VTK image: {error}") from error
    return found


def _one(elements: list[Element], tag: str, name: str) -> Element:
    chosen = [element for element in elements if element[0] == tag]
    if len(chosen) != 1:
        raise InputError(f"{name} has {len(chosen)} elements {tag}; one is read")
    return chosen[0]


def _chosen(elements: list[Element], array: str | None, name: str) -> tuple[dict[str, str], str, int]:
    """Attributes and text of the array that is read, and 1 if it has a value for each point, not each voxel."""
    place, marked = None, None
    arrays = []
    for tag, attributes, text in elements:
        if tag in ("CellData", "PointData", "FieldData", "Points", "Coordinates"):
            place, marked = tag, attributes.get("Scalars")
        elif tag == "DataArray" and place in ("CellData", "PointData"):
            wanted = array if array is not None else marked
            arrays.append((attributes, "".join(text), int(place == "PointData"), attributes.get("Name") == wanted))
    named = [entry for entry in arrays if entry[3]]
    chosen = named if named or array is not None else arrays
    if len(chosen) != 1:
        names = ", ".join(repr(entry[0].get("Name", "")) for entry in arrays) or "none"
        raise InputError(
            f"{name}: which array is meant is not clear; there are {names}", hint="name one with the option `array`"
        )
    return chosen[0][:3]


def _unpacked(
    source: bytes, coded: bool, compressed: bool, words: np.dtype[Any], size: int, compressor: str, name: str
) -> bytes:
    """The bytes of an array behind VTK's headers."""
    try:
        if not compressed:
            width = words.itemsize
            if coded:
                wanted = 4 * -(-(width + size) // 3)
                source = base64.b64decode(source[:wanted], validate=True)
            announced = int(np.frombuffer(source, words, 1)[0])
            if announced != size:
                raise InputError(f"{name}: {size} bytes of data are expected, {announced} announced")
            return source[width : width + size]
        if compressor != "vtkZLibDataCompressor":
            raise InputError(f"{name}: data compressed by {compressor!r} are not read; known is vtkZLibDataCompressor")
        return _inflated(source, coded, words, size, name)
    except (ValueError, binascii.Error, zlib.error) as error:
        raise InputError(f"{name}: the data are damaged: {error}") from error


def _inflated(source: bytes, coded: bool, words: np.dtype[Any], size: int, name: str) -> bytes:
    """Blocks of zlib streams, whose sizes stand in front."""

    def read(count: int) -> tuple[NDArray[Any], int]:
        """`count` words from the beginning, and where their encoding ends."""
        width = count * words.itemsize
        end = 4 * -(-width // 3) if coded else width
        raw = base64.b64decode(source[:end], validate=True) if coded else source[:end]
        return np.frombuffer(raw, words, count), end

    head, _ = read(3)
    blocks, full, last = (int(v) for v in head)
    if not 0 < blocks <= len(source) or full < 1 or (blocks - 1) * full + (last or full) != size:
        raise InputError(f"{name}: the compressed blocks do not add up to {size} bytes")
    sizes, end = read(3 + blocks)
    body = base64.b64decode(source[end:].split(b"\n")[0].strip(), validate=False) if coded else source[end:]
    pieces, at = [], 0
    for number, length in enumerate(int(v) for v in sizes[3:]):
        expected = (last or full) if number == blocks - 1 else full
        pieces.append(zlib.decompressobj().decompress(body[at : at + length], expected + 1))
        at += length
    return b"".join(pieces)
