"""PLY (Turk, 1994): ASCII and binary of both byte orders. Positions and faces are read, everything else is skipped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.encoding import as_written, in_blocks, little_endian
from sppm_pipeline.formats.machine_words import store4
from sppm_pipeline.formats.mesh_arrays import DecodedMesh, require_content, require_faces, require_room
from sppm_pipeline.formats.rows import read_face_rows, read_vertex_rows, skip_rows
from sppm_pipeline.formats.text import Bytes, as_lines
from sppm_pipeline.numerics.compiled import jit

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 20
_FACE_RECORD = 13  # a byte that says 3, and three vertex numbers of four bytes


class _Property(NamedTuple):
    name: str
    kind: str  # numpy type of the value, or of the items of a list
    counter: str  # numpy type of a list's length; empty for a single value

    @property
    def size(self) -> int:
        """Bytes of the value, or of the length of a list."""
        return int((self.counter or self.kind)[1])


class _Element(NamedTuple):
    name: str
    rows: int
    properties: list[_Property]

    @property
    def has_lists(self) -> bool:
        return any(entry.counter for entry in self.properties)

    @property
    def least_bytes(self) -> int:
        """Bytes of one row, its lists being empty."""
        return sum(entry.size for entry in self.properties)

    def place_of(self, name: str) -> int | None:
        """Index of a property; None if there is none of that name."""
        names = [entry.name for entry in self.properties]
        return names.index(name) if name in names else None


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh; polygons are cut into fans. Elements and properties other than positions and faces are skipped.

    Parameters
    ----------
    data : bytes-like
        The content of the file.
    name : str
        How to call the file in messages.

    Returns
    -------
    vertices : (n, 3) float64
    faces : (m, 3) int64

    Raises
    ------
    InputError
        With the line or byte of what is wrong.
    """
    require_content(data, name)
    order, elements, position = _header(data, name)
    names = [element.name for element in elements]
    for wanted in ("vertex", "face"):
        if names.count(wanted) != 1:
            hint = "triangle strips are not read: write plain faces" if "tristrips" in names else None
            raise InputError(
                f"{name}: the header announces {names.count(wanted)} elements {wanted!r}, not 1", hint=hint
            )
    if names.index("face") < names.index("vertex"):
        raise InputError(f"{name}: the faces come before the vertices")
    xyz = _coordinates(elements[names.index("vertex")], name)
    corners = _corner_list(elements[names.index("face")], name)
    if order:
        vertices, faces = _binary(data, name, order, elements, position, xyz, corners)
    else:
        vertices, faces = _ascii(data, name, elements, position, xyz, corners)
    require_faces(name, faces)
    return vertices, faces


def _header(data: bytes | memoryview | bytearray, name: str) -> tuple[str, list[_Element], int]:
    """Byte order (empty for ASCII), elements, and the place of the first byte after the header."""
    head = bytes(data[:_LONGEST_HEADER])
    stop = head.find(b"end_header")
    separator = b"\n" if b"\n" in head[: stop if stop >= 0 else None] else b"\r"
    order: str | None = None
    elements: list[_Element] = []
    position, number = 0, 0
    while True:
        end = head.find(separator, position)
        line = head[position : end if end >= 0 else len(head)]
        number += 1
        words = line.decode("ascii", "backslashreplace").split()
        if number == 1:
            if words != ["ply"]:
                raise InputError(f"{name}: line 1: a PLY file begins with a line 'ply', not {line[:40]!r}")
        elif words == ["end_header"]:
            break
        elif end < 0:
            raise InputError(
                f"{name}: line {number}: the header has no end_header within {len(head)} bytes",
                hint="the file is cut off, or no PLY",
            )
        elif words and words[0] not in ("comment", "obj_info"):
            try:
                order = _header_line(words, order, elements)
            except (ValueError, KeyError, IndexError) as error:
                raise InputError(
                    f"{name}: line {number} (byte {position}): {line[:60]!r} is no line of a PLY header"
                ) from error
        position = end + 1
    if order is None:
        raise InputError(f"{name}: the header has no line 'format'")
    return order, elements, (end + 1 if end >= 0 else len(head))


def _header_line(words: list[str], order: str | None, elements: list[_Element]) -> str | None:
    """Take up one line; any mistake in it raises one of the errors that `_header` translates."""
    if words[0] == "format" and order is None:
        return _FORMATS[words[1]]
    if words[0] == "element" and len(words) == 3 and words[2].isdigit() and len(words[2]) <= 18:
        elements.append(_Element(words[1], int(words[2]), []))
    elif words[0] == "property" and words[1] == "list" and len(words) == 5:
        counter = _TYPES[words[2]]
        if counter[0] == "f":
            raise ValueError
        elements[-1].properties.append(_Property(words[4], _TYPES[words[3]], counter))
    elif words[0] == "property" and len(words) == 3:
        elements[-1].properties.append(_Property(words[2], _TYPES[words[1]], ""))
    else:
        raise ValueError
    return order


def _coordinates(vertex: _Element, name: str) -> tuple[int, int, int]:
    places = [vertex.place_of(axis) for axis in "xyz"]
    if None in places or any(vertex.properties[place].counter for place in places if place is not None):
        found = ", ".join(entry.name for entry in vertex.properties[:20])
        raise InputError(f"{name}: the vertices need properties x, y and z, not {found or 'none'}")
    return places[0], places[1], places[2]  # type: ignore[return-value]


def _corner_list(face: _Element, name: str) -> int:
    for wanted in ("vertex_indices", "vertex_index"):
        place = face.place_of(wanted)
        if place is not None and face.properties[place].counter and face.properties[place].kind[0] != "f":
            return place
    found = ", ".join(entry.name for entry in face.properties[:20])
    raise InputError(f"{name}: the faces need a list of whole numbers 'vertex_indices', not {found or 'none'}")


def _ascii(
    data: bytes | memoryview | bytearray,
    name: str,
    elements: list[_Element],
    position: int,
    xyz: tuple[int, int, int],
    corners: int,
) -> DecodedMesh:
    lines = as_lines(data)
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int64)
    for element in elements:
        lists = tuple(bool(entry.counter) for entry in element.properties)
        require_room(name, element.name, element.rows, 2 * len(lists), lines.size - position + 1, position)
        if element.name == "vertex":
            vertices, position = read_vertex_rows(lines, position, element.rows, lists, xyz, name)
        elif element.name == "face":
            n = vertices.shape[0]
            faces, position = read_face_rows(lines, position, element.rows, lists[:corners], n, name)
            break
        elif lists:
            position = skip_rows(lines, position, element.rows, name)
    return vertices, faces


def _binary(
    data: bytes | memoryview | bytearray,
    name: str,
    order: str,
    elements: list[_Element],
    position: int,
    xyz: tuple[int, int, int],
    corners: int,
) -> DecodedMesh:
    array = np.frombuffer(data, np.uint8)
    array.flags.writeable = False
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int64)
    for element in elements:
        left = array.size - position
        require_room(name, f"elements {element.name!r}", element.rows, element.least_bytes, left, position)
        if element.name == "vertex":
            vertices, position = _positions(array, position, element, order, xyz, name)
        elif element.name == "face":
            starts, counts, position = _rows(array, position, element, order, (corners,), name)
            kind = element.properties[corners].kind
            faces = np.empty((int((counts - 2).sum()), 3), np.int64)
            face = _fans(
                array, starts[:, 0], counts, int(kind[1]), kind[0] == "i", order == ">", vertices.shape[0], faces
            )
            if face >= 0:
                where = f"face {face} (byte {starts[face, 0]})"
                raise InputError(
                    f"{name}: {where}: it names a vertex that does not exist; there are {vertices.shape[0]} vertices, "
                    "numbered from 0"
                )
            break
        else:
            _, _, position = _rows(array, position, element, order, (), name)
    return vertices, faces


def _positions(
    array: NDArray[np.uint8], position: int, element: _Element, order: str, xyz: tuple[int, int, int], name: str
) -> tuple[NDArray[np.float64], int]:
    """The coordinates (rows, 3) and the place after them."""
    starts, _, after = _rows(array, position, element, order, xyz, name)
    vertices = np.empty((element.rows, 3))
    for axis, place in enumerate(xyz):
        kind = np.dtype(order + element.properties[place].kind)
        if element.has_lists:
            values = np.empty((element.rows, kind.itemsize), np.uint8)
            for k in range(kind.itemsize):
                values[:, k] = array[starts[:, axis] + k]
            column = values.view(kind)[:, 0]
        elif element.rows:
            column = np.ndarray((element.rows,), kind, array.data, int(starts[0, axis]), (element.least_bytes,))
        else:
            break
        with np.errstate(invalid="ignore"):  # some numbers that are none complain when they are converted
            vertices[:, axis] = column
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        bad = int(np.flatnonzero(~finite)[0])
        where = f"vertex {bad} (byte {starts[bad].min()})"
        raise InputError(f"{name}: {where}: a coordinate must be finite, not {vertices[bad].tolist()}")
    return vertices, after


def _rows(
    array: NDArray[np.uint8], position: int, element: _Element, order: str, wanted: tuple[int, ...], name: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], int]:
    """Where the wanted properties of each row begin (rows, wanted), the length of the last one, and the place after."""
    if not element.has_lists:
        row = element.least_bytes
        offsets = np.cumsum([0, *(entry.size for entry in element.properties)])[list(wanted)]
        count = element.rows if wanted else 0
        starts = position + row * np.arange(count)[:, None] + offsets.astype(np.int64)
        return starts, np.ones(count, np.int64), position + row * element.rows
    counters = np.array([int(entry.counter[1]) if entry.counter else 0 for entry in element.properties], np.int64)
    signed = np.array([entry.counter[:1] == "i" for entry in element.properties], np.bool_)
    sizes = np.array([int(entry.kind[1]) for entry in element.properties], np.int64)
    column = np.full(len(element.properties), -1, np.int64)
    column[list(wanted)] = range(len(wanted))
    starts = np.empty((element.rows if wanted else 0, len(wanted)), np.int64)
    counts = np.empty(starts.shape[0], np.int64)
    position, row, short = _walk(
        array, position, element.rows, counters, signed, sizes, column, order == ">", starts, counts
    )
    if row >= 0 and short:
        raise InputError(f"{name}: {element.name} {row} (byte {position}): a face has at least three corners")
    if row >= 0:
        raise InputError(
            f"{name}: {element.name} {row} (byte {position}): a list has a negative length or runs past the end of "
            f"the file ({array.size} bytes)",
            hint="the file is cut off, or its header does not fit its content",
        )
    return starts, counts, int(position)


@jit
def _integer(array: Bytes, i: int, size: int, signed: bool, big: bool) -> int:
    value = np.uint64(0)
    for k in range(size):
        byte = array[i + k] if big else array[i + size - 1 - k]
        value = value << np.uint64(8) | np.uint64(byte)
    if signed:
        unused = np.uint64(64 - 8 * size)
        return int(np.int64(value << unused) >> np.int64(unused))
    return int(np.int64(value))  # beyond 2^63 it turns negative, which no caller accepts


@jit
def _walk(
    array: Bytes,
    i: int,
    rows: int,
    counters: NDArray[np.int64],
    signed: NDArray[np.bool_],
    sizes: NDArray[np.int64],
    column: NDArray[np.int64],
    big: bool,
    starts: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> tuple[int, int, bool]:
    """Follow rows of variable length; returns the place after them and -1.

    Or the place and number of a broken row, and whether it is broken because a wanted list has no three entries.
    """
    for row in range(rows):
        for c in range(sizes.size):
            length = 1
            if counters[c] > 0:
                if i + counters[c] > array.size:
                    return i, row, False
                length = _integer(array, i, counters[c], signed[c], big)
                i += counters[c]
            if length < 0 or length > (array.size - i) // sizes[c]:
                return i, row, False
            if column[c] >= 0:
                if counters[c] > 0 and length < 3:
                    return i, row, True
                starts[row, column[c]] = i
                counts[row] = length
            i += length * sizes[c]
    return i, -1, False


@jit
def _fans(
    array: Bytes,
    starts: NDArray[np.int64],
    counts: NDArray[np.int64],
    size: int,
    signed: bool,
    big: bool,
    n_vertices: int,
    faces: NDArray[np.int64],
) -> int:
    """Triangles of the polygons; returns the number of a polygon with a wrong vertex, or -1."""
    m = 0
    for row in range(starts.size):
        first, before = 0, 0
        for k in range(counts[row]):
            index = _integer(array, starts[row] + k * size, size, signed, big)
            if index < 0 or index >= n_vertices:
                return row
            if k == 0:
                first = index
            elif k > 1:
                faces[m, 0], faces[m, 1], faces[m, 2] = first, before, index
                m += 1
            before = index
    return -1


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), as binary little-endian PLY, piece by piece.

    Positions keep their type: float32 as ``float``, everything else as ``double``. Same mesh, same bytes.
    """
    points, triangles, _ = as_written(vertices, faces)
    kind = "float" if points.dtype == np.float32 else "double"
    lines = ["ply", "format binary_little_endian 1.0", "comment written by sppm", f"element vertex {points.shape[0]}"]
    lines += [f"property {kind} {axis}" for axis in "xyz"]
    lines += [f"element face {triangles.shape[0]}", "property list uchar int vertex_indices", "end_header"]
    yield ("\n".join(lines) + "\n").encode()
    yield from in_blocks(len(points), lambda rows: little_endian(points[rows]), 1)
    yield from in_blocks(len(triangles), lambda rows: _face_records(triangles[rows]), threads)


def _face_records(faces: NDArray[np.int32]) -> memoryview:
    out = np.empty(_FACE_RECORD * faces.shape[0], np.uint8)
    _put_faces(out, faces)
    return out.data


@jit
def _put_faces(out: Bytes, faces: NDArray[np.int32]) -> None:
    for row in range(faces.shape[0]):
        i = 13 * row
        out[i] = 3
        for c in range(3):
            store4(out, i + 1 + 4 * c, np.uint32(faces[row, c]))
