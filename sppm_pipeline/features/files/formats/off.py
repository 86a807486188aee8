"""OFF, the text form of Geomview's object file format; normals, colors and texture coordinates are skipped."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.services.formats.encoding import as_written, in_blocks
from sppm_pipeline.services.formats.mesh_arrays import DecodedMesh, decoded, require_content, require_room
from sppm_pipeline.services.formats.text import Lines, fan, shown

_MAGIC = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF", b"STCOFF", b"STNOFF", b"STCNOFF")
_SHORTEST_VERTEX, _SHORTEST_FACE = len(b"0 0 0\n"), len(b"3 0 1 2\n")
_CUT_OFF = "the file ends before its last vertex or face"
_VERTEX, _FACE = Words.of(b"", b" ", b" ", b"\n"), Words.of(b"3 ", b" ", b" ", b"\n")


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh; polygons are cut into fans. See `detect.decode_mesh` for what all readers take, return and raise."""
    require_content(data, name)
    lines = Lines(data, name)
    rows = iter(lines)
    n_vertices, n_faces = _counts(lines, rows)
    # a count that the rest of the file cannot hold is refused before any loop runs over it
    require_room(name, "vertices", n_vertices, _SHORTEST_VERTEX, len(data) - lines.end + 1, lines.end)
    coordinates, corners = array("d"), array("q")
    for _ in range(n_vertices):
        words = lines.row(rows, _CUT_OFF)
        if len(words) < 3:
            lines.fail("the line has too few numbers")
        coordinates.extend(lines.floats(words[:3]))
    require_room(name, "faces", n_faces, _SHORTEST_FACE, len(data) - lines.end + 1, lines.end)
    for _ in range(n_faces):
        words = lines.row(rows, _CUT_OFF)
        count = lines.integer(words[0])
        if count is None or count < 0:
            lines.fail(f"an integer is expected, not {shown(words[0])}", words[0])
        if len(words) <= count:
            lines.fail("the line has too few numbers")
        corners.extend(fan(lines.polygon(words[1 : count + 1], n_vertices)))
    return decoded(name, coordinates, corners)


def _counts(lines: Lines, rows: Iterator[list[bytes]]) -> list[int]:
    """The numbers of vertices and faces."""
    first = next(rows, [b""])
    if first[0] not in _MAGIC:
        hint = "binary OFF and OFF of other dimensions are not read" if b"OFF" in first[0] else None
        raise InputError(f"{lines.name}: the first word of an OFF file is OFF, not {shown(first[0])}", hint=hint)
    words = first[1:]
    while len(words) < 2:
        words += lines.row(rows, "the numbers of vertices and faces are missing")
    for word in words[:2]:
        if not word.isdigit() or len(word) > 18:
            lines.fail(f"the number of vertices or faces is expected, not {shown(word)}", word)
    return [int(word) for word in words[:2]]


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), piece by piece.

    Coordinates are rounded to 5e-10 of the power of ten above the largest one. Same mesh, same bytes.
    """
    mesh = as_written(vertices, faces)
    scale = decimal_scale(mesh.largest)
    yield f"OFF\n# written by sppm\n{len(mesh.points)} {len(mesh.faces)} 0\n".encode()
    yield from in_blocks(len(mesh.points), lambda rows: vertex_rows(mesh.points[rows], scale, _VERTEX), threads)
    yield from in_blocks(len(mesh.faces), lambda rows: face_rows(mesh.faces[rows], 0, _FACE), threads)
