"""Wavefront OBJ: positions and faces of the text format; everything else in it is skipped."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.formats.encoding import as_written, in_blocks
from sppm_pipeline.formats.mesh_arrays import DecodedMesh, require_content, require_faces
from sppm_pipeline.formats.text import (
    Bytes,
    as_lines,
    fail_at,
    pending_floats,
    resolve_floats,
    scan_float,
    scan_index,
    shown,
    skip_blanks,
    skip_line,
    skip_token,
)
from sppm_pipeline.numerics.compiled import jit

_V, _F, _SPACE, _TAB, _NEWLINE, _SLASH, _HASH = 118, 102, 32, 9, 10, 47, 35
_OK, _SHORT_VERTEX, _SHORT_FACE, _NO_INDEX, _OUT_OF_RANGE = range(5)
_MESSAGES = {
    _SHORT_VERTEX: "a vertex has three coordinates",
    _SHORT_FACE: "a face has at least three corners",
    _NO_INDEX: "a corner of a face is a vertex number, perhaps with /texture/normal, not {word}",
    _OUT_OF_RANGE: "there is no vertex {word}; the file has {vertices} vertices (vertex numbers start at 1)",
}
_VERTEX, _FACE = Words.of(b"v ", b" ", b" ", b"\n"), Words.of(b"f ", b" ", b" ", b"\n")


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh.

    Polygons are cut into fans; relative (negative) vertex numbers, ``a/b/c`` corners, colors behind the coordinates,
    comments and continued lines are understood. Every face of the file is taken, whatever object or group it is in.

    Parameters
    ----------
    data : bytes-like
        The content of the file.
    name : str
        How to call the file in messages.

    Returns
    -------
    vertices : (n, 3) float64
        In the order of the file, correctly rounded.
    faces : (m, 3) int64

    Raises
    ------
    InputError
        With the line and byte of what is wrong.
    """
    require_content(data, name)
    lines = as_lines(data)
    empty = np.empty((0, 3)), np.empty((0, 3), np.int64), pending_floats(0)
    status, where, n_vertices, n_faces, _ = _scan(lines, *empty, 0, False)
    if status == _OK:
        vertices, faces = np.empty((n_vertices, 3)), np.empty((n_faces, 3), np.int64)
        pending = pending_floats(3 * n_vertices)
        status, where, _, _, n_pending = _scan(lines, vertices, faces, pending, n_vertices, True)
    if status != _OK:
        message = _MESSAGES[status].format(word=shown(lines, where), vertices=n_vertices)
        fail_at(lines, where, name, message)
    resolve_floats(lines, pending[:n_pending], vertices.reshape(-1), name)
    require_faces(name, faces)
    return vertices, faces


@jit
def _scan(
    data: Bytes,
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    pending: NDArray[np.int64],
    total: int,
    fill: bool,
) -> tuple[int, int, int, int, int]:
    """Walk over the lines; count vertices and triangles, or fill the arrays if `fill`.

    Returns the status, the place of the fault, and the numbers of vertices, triangles and pending floats.
    """
    n, m, p = 0, 0, 0
    i = 0
    while i < data.size:
        i = skip_blanks(data, i)
        if i + 1 >= data.size or (data[i] != _V and data[i] != _F) or (data[i + 1] != _SPACE and data[i + 1] != _TAB):
            i = skip_line(data, i)
            continue
        line, is_vertex = i, data[i] == _V
        i = skip_blanks(data, i + 1)
        if is_vertex and fill:
            for c in range(3):
                if i >= data.size or data[i] == _NEWLINE or data[i] == _HASH:
                    return _SHORT_VERTEX, line, n, m, p
                vertices[n, c], end, exact = scan_float(data, i)
                if not exact:
                    pending[p, 0], pending[p, 1], pending[p, 2] = 3 * n + c, i, end
                    p += 1
                i = skip_blanks(data, end)
        elif not is_vertex:
            corners = 0
            first, before = 0, 0
            while i < data.size and data[i] != _NEWLINE and data[i] != _HASH:
                if fill:
                    index, end, found = scan_index(data, i)
                    if not found:
                        return _NO_INDEX, i, n, m, p
                    index = n + index if index < 0 else index - 1
                    if index < 0 or index >= total:
                        return _OUT_OF_RANGE, i, total, m, p
                    if corners == 0:
                        first = index
                    elif corners > 1:
                        faces[m, 0], faces[m, 1], faces[m, 2] = first, before, index
                        m += 1
                    before = index
                elif corners > 1:
                    m += 1
                corners += 1
                i = skip_blanks(data, skip_token(data, i))
            if corners < 3:
                return _SHORT_FACE, line, n, m, p
        if is_vertex:
            n += 1
        i = skip_line(data, i)
    return _OK, 0, n, m, p


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), piece by piece.

    Coordinates are rounded to 5e-10 of the power of ten above the largest one. Same mesh, same bytes.
    """
    mesh = as_written(vertices, faces)
    scale = decimal_scale(mesh.largest)
    yield b"# OBJ written by sppm\n"
    yield from in_blocks(len(mesh.points), lambda rows: vertex_rows(mesh.points[rows], scale, _VERTEX), threads)
    yield from in_blocks(len(mesh.faces), lambda rows: face_rows(mesh.faces[rows], 1, _FACE), threads)
