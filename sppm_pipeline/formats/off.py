"""OFF, the text form of Geomview's object file format; normals, colors and texture coordinates are skipped."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.formats.encoding import as_written, in_blocks
from sppm_pipeline.formats.mesh_arrays import DecodedMesh, require_content, require_faces, require_room
from sppm_pipeline.formats.rows import read_face_rows, read_vertex_rows
from sppm_pipeline.formats.text import as_lines, fail_at, shown

_NEWLINE = 10
_MAGIC = (b"OFF", b"COFF", b"NOFF", b"CNOFF", b"STOFF", b"STCOFF", b"STNOFF", b"STCNOFF")
_SHORTEST_VERTEX, _SHORTEST_FACE = len(b"0 0 0\n"), len(b"3 0 1 2\n")
_LINE, _HEADER_LINES = 4096, 1000  # how much of a line is looked at, and how many lines, until the counts are found
_VERTEX, _FACE = Words.of(b"", b" ", b" ", b"\n"), Words.of(b"3 ", b" ", b" ", b"\n")


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh; polygons are cut into fans.

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
        With the line and byte of what is wrong.
    """
    require_content(data, name)
    lines = as_lines(data)
    (n_vertices, n_faces), position = _header(lines, name)
    require_room(name, "vertices", n_vertices, _SHORTEST_VERTEX, lines.size - position + 1, position)
    vertices, position = read_vertex_rows(lines, position, n_vertices, (False,) * 3, (0, 1, 2), name)
    require_room(name, "faces", n_faces, _SHORTEST_FACE, lines.size - position + 1, position)
    faces, _ = read_face_rows(lines, position, n_faces, (), n_vertices, name)
    require_faces(name, faces)
    return vertices, faces


def _header(lines: NDArray[np.uint8], name: str) -> tuple[list[int], int]:
    """The numbers of vertices and faces, and the place after their line."""
    words: list[tuple[bytes, int]] = []
    position = 0
    for _ in range(_HEADER_LINES):
        if len(words) >= 3 or position >= lines.size:
            break
        line = lines[position : position + _LINE].tobytes().split(b"\n", 1)[0]
        found = line.split(b"#", 1)[0].split()
        words += [(word, position) for word in found]
        if len(line) == _LINE:
            rest = np.flatnonzero(lines[position:] == _NEWLINE)
            position += int(rest[0]) + 1 if rest.size else lines.size
        else:
            position += len(line) + 1
    if not words or words[0][0] not in _MAGIC:
        hint = "binary OFF and OFF of other dimensions are not read" if words and b"OFF" in words[0][0] else None
        raise InputError(f"{name}: the first word of an OFF file is OFF, not {shown(lines, 0)}", hint=hint)
    counts = []
    for word, place in words[1:3]:
        if not word.isdigit() or len(word) > 18:
            fail_at(lines, place, name, f"the number of vertices or faces is expected, not {word[:40]!r}")
        counts.append(int(word))
    if len(counts) < 2:
        fail_at(lines, position, name, "the numbers of vertices and faces are missing")
    return counts, min(position, lines.size)


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
