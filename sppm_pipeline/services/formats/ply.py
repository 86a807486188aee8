"""PLY (Turk, 1994): ASCII and binary of both byte orders. Positions and faces are read, everything else is skipped.

This format is not left to a library: trimesh refuses binary files whose polygons have different numbers of corners, and
takes rows at a length that is not the one they state.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.formats.encoding import Bytes, InPieces, as_written, in_blocks, little_endian, store4
from sppm_pipeline.services.formats.mesh_arrays import (
    DecodedMesh,
    decoded,
    require_content,
    require_faces,
    require_room,
)
from sppm_pipeline.services.formats.text import Lines, fan, shown
from sppm_pipeline.services.jit.compiled import jit

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "i8": "q", "u8": "Q"}  # of struct
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
    def min_bytes(self) -> int:
        """Bytes of one row, its lists being empty."""
        return sum(entry.size for entry in self.properties)

    def place_of(self, name: str) -> int | None:
        """Index of a property; None if there is none of that name."""
        names = [entry.name for entry in self.properties]
        return names.index(name) if name in names else None


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh; polygons are cut into fans. Elements and properties other than positions and faces are skipped.

    See `detect.decode_mesh` for what all readers take, return and raise.
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
    read = _binary if order else _ascii
    vertices, faces = read(data, name, order, elements, position, xyz, corners)
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
    raise InputError(f"{name}: the faces need a list of integers 'vertex_indices', not {found or 'none'}")


def _ascii(
    data: bytes | memoryview | bytearray,
    name: str,
    order: str,
    elements: list[_Element],
    position: int,
    xyz: tuple[int, int, int],
    corners: int,
) -> DecodedMesh:
    lines = Lines(data, name, start=position)
    rows = iter(lines)
    coordinates, triangles = array("d"), array("q")
    for element in elements:
        width = len(element.properties)
        require_room(name, element.name, element.rows, 2 * width, len(data) - lines.end + 1, lines.end)
        for _ in range(element.rows if width else 0):
            words = lines.row(rows, "the file ends before the last line that its header announces")
            places = _places(lines, words, element)
            if element.name == "vertex":
                coordinates.extend(lines.floats([words[places[axis]] for axis in xyz]))
            elif element.name == "face":
                first = places[corners]
                count = int(words[first])
                triangles.extend(fan(lines.polygon(words[first + 1 : first + 1 + count], len(coordinates) // 3)))
        if element.name == "face":
            break
    return decoded(name, coordinates, triangles)


def _places(lines: Lines, words: list[bytes], element: _Element) -> Sequence[int]:
    """Offset of each property in a row; a list begins with its length."""
    places, place = [], 0
    for entry in element.properties:
        places.append(place)
        if entry.counter and place < len(words):
            length = lines.integer(words[place])
            if length is None or length < 0:
                lines.fail(f"an integer is expected, not {shown(words[place])}", words[place])
            place += length
        place += 1
        if place > len(words):
            lines.fail("the line has too few numbers")
    return places


def _binary(
    data: bytes | memoryview | bytearray,
    name: str,
    order: str,
    elements: list[_Element],
    position: int,
    xyz: tuple[int, int, int],
    corners: int,
) -> DecodedMesh:
    view = memoryview(data).cast("B")
    vertices, faces = np.empty((0, 3)), np.empty((0, 3), np.int64)
    for element in elements:
        left = len(view) - position
        require_room(name, f"elements {element.name!r}", element.rows, element.min_bytes, left, position)
        if not element.properties:
            continue
        start = position
        groups, position = _rows(view, position, element, order, name)
        if element.name == "vertex":
            vertices = _positions(groups, element.rows, xyz, start, name)
        elif element.name == "face":
            faces = _triangles(groups, corners, len(vertices), start, name)
            break
    return vertices, faces


class _Rows(NamedTuple):
    """Rows of an element whose lists are of the same lengths."""

    numbers: I64
    values: NDArray[Any]  # fields ``p0``, ``p1`` ... are the properties, ``n0``, ``n1`` ... the lengths of lists


def _row_type(element: _Element, order: str, lengths: Sequence[int]) -> np.dtype[Any]:
    """The type of a row whose lists have these lengths."""
    fields: list[tuple[Any, ...]] = []
    remaining = iter(lengths)
    for k, entry in enumerate(element.properties):
        if entry.counter:
            fields += [(f"n{k}", order + entry.counter), (f"p{k}", order + entry.kind, (next(remaining),))]
        else:
            fields.append((f"p{k}", order + entry.kind))
    return np.dtype(fields)


def _rows(view: memoryview, position: int, element: _Element, order: str, name: str) -> tuple[list[_Rows], int]:
    """The rows of an element, and the place after them."""
    if not element.rows:
        return [], position
    lengths, _, _ = _walk(view, position, element, order, 1, name)
    kind = _row_type(element, order, lengths[0])
    if kind.itemsize * element.rows <= len(view) - position:
        values = np.frombuffer(view, kind, element.rows, position)
        counters = [f"n{k}" for k, entry in enumerate(element.properties) if entry.counter]
        if all((values[counter] == values[counter][0]).all() for counter in counters):
            return [_Rows(np.arange(element.rows), values)], position + kind.itemsize * element.rows
    lengths, begins, position = _walk(view, position, element, order, element.rows, name)
    starts, data = np.array(begins, np.int64), np.frombuffer(view, np.uint8)
    same: dict[tuple[int, ...], list[int]] = {}
    for number, key in enumerate(lengths):
        same.setdefault(key, []).append(number)
    groups = []
    for key, members in same.items():
        kind, numbers = _row_type(element, order, key), np.array(members)
        gathered = data[starts[numbers][:, None] + np.arange(kind.itemsize)]
        groups.append(_Rows(numbers, gathered.view(kind)[:, 0]))
    return groups, position


def _walk(
    view: memoryview, position: int, element: _Element, order: str, rows: int, name: str
) -> tuple[list[tuple[int, ...]], list[int], int]:
    """Lengths of lists and first byte of each row, and the place after the last."""
    steps, skip = [], 0  # single values to skip, the length of a list, bytes of its items
    for entry in element.properties:
        if entry.counter:
            steps.append((skip, struct.Struct(order + _CODES[entry.counter]), int(entry.kind[1])))
            skip = 0
        else:
            skip += entry.size
    least = 3 if element.name == "face" and len(steps) == 1 else 0
    found, begins = [], []
    for row in range(rows):
        begins.append(position)
        lengths = []
        for before, counter, size in steps:
            position += before
            length = counter.unpack_from(view, position)[0] if position + counter.size <= len(view) else -1
            position += counter.size
            if not 0 <= length <= (len(view) - position) // size:
                _fail_row(name, element, row, begins[-1], len(view))
            if length < least:
                raise InputError(f"{name}: face {row} (byte {begins[-1]}): a face has at least three corners")
            lengths.append(length)
            position += length * size
        position += skip
        if position > len(view):
            _fail_row(name, element, row, begins[-1], len(view))
        found.append(tuple(lengths))
    return found, begins, position


def _fail_row(name: str, element: _Element, row: int, begin: int, size: int) -> NoReturn:
    raise InputError(
        f"{name}: {element.name} {row} (byte {begin}): a list has a negative length or runs past the end of the file "
        f"({size} bytes)",
        hint="the file is cut off, or its header does not fit its content",
    )


def _positions(groups: list[_Rows], count: int, xyz: tuple[int, int, int], start: int, name: str) -> F64:
    vertices = np.empty((count, 3))
    with np.errstate(invalid="ignore"):  # signaling NaN complain when they are converted
        for group in groups:
            vertices[group.numbers] = np.stack([group.values[f"p{axis}"].astype(np.float64) for axis in xyz], axis=1)
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        bad = int(np.argmin(finite))
        where = f"vertex {bad} (the vertices begin at byte {start})"
        raise InputError(f"{name}: {where}: a coordinate must be finite, not {vertices[bad].tolist()}")
    return vertices


def _triangles(groups: list[_Rows], corners: int, n_vertices: int, start: int, name: str) -> I64:
    """The fans of all polygons, in the order of the file."""
    fans, numbers = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
    for group in groups:
        polygons = group.values[f"p{corners}"]
        wrong = ((polygons < 0) | (polygons >= n_vertices)).any(axis=1)
        if polygons.shape[1] < 3 or wrong.any():
            row = group.numbers[np.argmax(wrong)]
            reason = (
                "a face has at least three corners"
                if polygons.shape[1] < 3
                else f"it names a vertex that does not exist; there are {n_vertices} vertices, numbered from 0"
            )
            raise InputError(f"{name}: face {row} (the faces begin at byte {start}): {reason}")
        first = np.repeat(polygons[:, :1], polygons.shape[1] - 2, axis=1)
        made = np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2)
        fans.append(made.reshape(-1, 3).astype(np.int64))
        numbers.append(np.repeat(group.numbers, polygons.shape[1] - 2))
    faces = np.concatenate(fans)
    return faces if len(groups) == 1 else faces[np.argsort(np.concatenate(numbers), kind="stable")]


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), as binary little-endian PLY, piece by piece.

    Positions keep their type: float32 as ``float``, everything else as ``double``. Same mesh, same bytes.
    """
    points, triangles, _ = as_written(vertices, faces)
    yield _head_of(len(points), len(triangles), "float" if points.dtype == np.float32 else "double")
    yield from in_blocks(len(points), lambda rows: little_endian(points[rows]), 1, points)
    yield from in_blocks(len(triangles), lambda rows: _face_records(triangles[rows]), threads, triangles)


def in_pieces(vertices: int, faces: int, reach: tuple[float, float]) -> InPieces | None:
    """Encoder of a mesh of float64 with known numbers of vertices and faces, while it comes in pieces.

    The largest absolute coordinate lies within `reach`. None if more of the mesh has to be known.
    """
    head = _head_of(vertices, faces, "double")
    return InPieces(
        head, lambda points, known, _: little_endian(points[known:]), _face_records, len(head) + 24 * vertices
    )


def _head_of(vertices: int, faces: int, kind: str) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", "comment written by sppm", f"element vertex {vertices}"]
    lines += [f"property {kind} {axis}" for axis in "xyz"]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header"]
    return ("\n".join(lines) + "\n").encode()


def _face_records(faces: I32) -> memoryview:
    out = np.empty(_FACE_RECORD * faces.shape[0], np.uint8)
    _put_faces(out, faces)
    return out.data


@jit
def _put_faces(out: Bytes, faces: I32) -> None:
    for row in range(faces.shape[0]):
        i = 13 * row
        out[i] = 3
        for c in range(3):
            store4(out, i + 1 + 4 * c, np.uint32(faces[row, c]))
