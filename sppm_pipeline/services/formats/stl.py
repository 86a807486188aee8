"""STL, binary and ASCII. The format has no shared vertices: equal positions are merged on reading."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.formats.encoding import (
    Bytes,
    InPieces,
    as_written,
    in_blocks,
    largest,
    require_float32,
    store2,
    store4,
)
from sppm_pipeline.services.formats.mesh_arrays import (
    DecodedMesh,
    GroupLog,
    Groups,
    merge_equal,
    require_content,
    require_faces,
    require_room,
)
from sppm_pipeline.services.formats.text import Lines, shown
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.measures import edge_counts

_HEADER, _RECORD = 84, 50
_MINUS_ZERO = np.uint32(1 << 31)
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def is_binary(data: bytes | memoryview | bytearray) -> bool:
    """True if the size is that of the number of triangles in the header; a few stray bytes more are allowed."""
    if len(data) < _HEADER:
        return False
    return 0 <= len(data) - _HEADER - _RECORD * int.from_bytes(data[80:84], "little") < _RECORD


def is_ascii(data: bytes | memoryview | bytearray) -> bool:
    """True for what is like ASCII STL: ``solid``, and ``facet`` or ``endsolid`` soon after, or no byte but text."""
    head = bytes(data[:4096]).lstrip().lower()
    if not head.startswith(b"solid"):
        return False
    return b"facet" in head or b"endsolid" in head or all(c >= 32 or c in b"\t\r\n\f" for c in head)


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh and merge equal corners, numbered in the order of their first use.

    A file that begins with ``solid`` is binary all the same if its size fits the number of triangles in its header.

    Corners are merged if they are equal as float32; if that leaves the surface open, and merging those that are equal
    to 2^-24 of the largest coordinate closes it, then those. Of the corners merged the first one is kept. Normals and
    attributes are ignored. See `detect.decode_mesh` for what all readers take, return and raise.
    """
    return decode_with_groups(data, name)[0]


def decode_with_groups(data: bytes | memoryview | bytearray, name: str) -> tuple[DecodedMesh, Groups]:
    """`decode`, and the triangles of the solids of an ASCII file that have names."""
    require_content(data, name)
    named = GroupLog()
    if not is_binary(data) and is_ascii(data):
        corners: NDArray[np.floating] = _ascii_corners(data, name, named)
    else:
        corners = _binary_corners(data, name)
    rounded = corners.astype(np.float32, copy=False)
    if (rounded.view(np.uint32) == _MINUS_ZERO).any():
        rounded = rounded + np.float32(0)  # turns -0 into 0, which is the same place with other bits
    first, numbers = merge_equal(rounded)
    del rounded
    faces = numbers.reshape(-1, 3)
    require_faces(name, faces)
    if not edge_counts(faces).closed:
        # CAD programs leave noise of 1e-16 where they mean 0, and so boundary loops that are none.
        step = largest(corners.reshape(-1)) / 2**24 or 1.0
        first_coarse, numbers = merge_equal(np.rint(corners.astype(np.float64) / step).astype(np.int32))
        coarse = numbers.reshape(-1, 3)
        if edge_counts(coarse).closed:
            first, faces = first_coarse, coarse
    return (corners[first].astype(np.float64), faces.astype(np.int64)), named.groups(len(faces))


def _binary_corners(data: bytes | memoryview | bytearray, name: str) -> F32:
    if len(data) < _HEADER:
        raise InputError(
            f"{name}: {len(data)} bytes are too few for a binary STL, whose header alone takes {_HEADER}, "
            "and the file does not begin like an ASCII STL",
            hint="the file is cut off, or no STL",
        )
    claimed = int.from_bytes(data[80:84], "little")
    require_room(name, "triangles", claimed, _RECORD, len(data) - _HEADER, _HEADER)
    surplus = len(data) - _HEADER - _RECORD * claimed
    if surplus >= _RECORD:
        raise InputError(
            f"{name}: the header (byte 80) claims {claimed} triangles, but {surplus} more bytes follow them",
            hint="the number of triangles is wrong: write the file again",
        )
    records = np.frombuffer(data, _TRIANGLE, claimed, _HEADER)
    corners = np.ascontiguousarray(records["corners"]).reshape(-1, 3)
    if not np.isfinite(largest(corners.reshape(-1))):
        bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise InputError(
            f"{name}: triangle {bad // 3} (byte {_HEADER + _RECORD * (bad // 3)}): a coordinate must be finite, "
            f"not {corners[bad].tolist()}"
        )
    return corners


def _ascii_corners(data: bytes | memoryview | bytearray, name: str, named: GroupLog) -> F64:
    lines = Lines(data, name, comment=b"")
    coordinates = array("d")
    words = _words(lines, lambda solid: named.begin("solid", solid, len(coordinates) // 9))
    in_loop = -1  # vertices in the loop that is open
    for word in words:
        keyword = word.lower()
        if keyword == b"normal" or (keyword == b"vertex" and in_loop >= 0):
            numbers = list(islice(words, 3))
            if len(numbers) < 3:
                lines.fail("the file ends within a triangle")
            if keyword == b"vertex":
                coordinates.extend(lines.floats(numbers))
                in_loop += 1
        elif (keyword == b"loop" and in_loop >= 0) or (keyword in (b"endloop", b"endsolid") and in_loop not in (-1, 3)):
            lines.fail("a loop has exactly three vertices", word)
        elif keyword in (b"loop", b"endloop"):
            if keyword == b"endloop" and in_loop < 0:
                lines.fail("a loop has exactly three vertices", word)
            in_loop = 0 if keyword == b"loop" else -1
        elif keyword not in (b"facet", b"outer", b"endfacet", b"solid", b"endsolid"):
            lines.fail(f"{shown(word)} is no word of ASCII STL", word)
    if in_loop >= 0:
        lines.fail("the file ends within a triangle")
    corners = np.frombuffer(coordinates, np.float64).reshape(-1, 3) if coordinates else np.empty((0, 3))
    too_large = np.abs(corners) > np.finfo(np.float32).max
    if too_large.any():
        raise InputError(f"{name}: the coordinate {corners[too_large][0]} is beyond the range of STL (float32)")
    return corners


def _words(lines: Lines, begin: Callable[[list[bytes]], None]) -> Iterator[bytes]:
    """The words of the file, but for the names of solids; `begin` gets the name of each, and its end."""
    for words in lines:
        for at, word in enumerate(words):
            yield word
            if word.lower() in (b"solid", b"endsolid"):
                begin([b" ".join(words[at + 1 :])] if word.lower() == b"solid" and words[at + 1 :] else [])
                break


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), as binary STL, piece by piece.

    Positions are rounded to float32; the normals are those of the rounded triangles, 0 for one without area. The unit
    is not recorded: STL has none. Same mesh, same bytes.
    """
    mesh = as_written(vertices, faces)
    require_float32(mesh, "STL")
    if len(mesh.faces) >= 2**32:
        raise DesignError("STL counts up to 2^32 - 1 triangles", hint="write the mesh as PLY")
    yield _head_of(len(mesh.faces))
    yield from in_blocks(len(mesh.faces), lambda rows: _records(mesh.points, mesh.faces[rows]), threads, *mesh[:2])


def in_pieces(vertices: int, faces: int, reach: tuple[float, float]) -> InPieces | None:
    """See `ply.in_pieces`."""
    if faces >= 2**32 or reach[1] > float(np.finfo(np.float32).max):
        return None  # which `encode` refuses
    return InPieces(_head_of(faces), lambda points, known, corners: _records(points, corners))


def _head_of(faces: int) -> bytes:
    # A binary STL must not begin with "solid".
    return b"binary STL written by sppm".ljust(80) + faces.to_bytes(4, "little")


def _records(points: NDArray[np.floating], faces: I32) -> memoryview:
    out = np.empty(_RECORD * faces.shape[0], np.uint8)
    _put_triangles(out, points, faces)
    return out.data


@jit
def _put_triangles(out: Bytes, points: NDArray[np.floating], faces: I32) -> None:
    """Records of the normal, the corners and two bytes of nothing."""
    rounded = np.empty((4, 3), np.float32)  # the normal and the corners
    bits = rounded.view(np.uint32)
    for row in range(faces.shape[0]):
        i = 50 * row
        for corner in range(3):
            for axis in range(3):
                rounded[1 + corner, axis] = points[faces[row, corner], axis]
        ux = np.float64(rounded[2, 0]) - np.float64(rounded[1, 0])
        uy = np.float64(rounded[2, 1]) - np.float64(rounded[1, 1])
        uz = np.float64(rounded[2, 2]) - np.float64(rounded[1, 2])
        vx = np.float64(rounded[3, 0]) - np.float64(rounded[1, 0])
        vy = np.float64(rounded[3, 1]) - np.float64(rounded[1, 1])
        vz = np.float64(rounded[3, 2]) - np.float64(rounded[1, 2])
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        scale = 1.0 / length if length > 0.0 else 0.0
        rounded[0, 0], rounded[0, 1], rounded[0, 2] = nx * scale, ny * scale, nz * scale
        for axis in range(3):
            for corner in range(4):
                store4(out, i + 12 * corner + 4 * axis, bits[corner, axis])
        store2(out, i + 48, np.uint16(0))
