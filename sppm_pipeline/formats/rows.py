"""Tables in ASCII mesh files (PLY, OFF): one vertex or one face a line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.text import (
    Bytes,
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

_NEWLINE, _HASH = 10, 35
_SKIPPED, _LIST = -1, -2
_OK, _CUT_OFF, _SHORT_ROW, _NO_INTEGER, _SHORT_FACE, _OUT_OF_RANGE = range(6)
_MESSAGES = {
    _CUT_OFF: "the file ends before its last vertex or face",
    _SHORT_ROW: "the line has too few numbers",
    _NO_INTEGER: "a whole number is expected, not {word}",
    _SHORT_FACE: "a face has at least three corners, not {word}",
    _OUT_OF_RANGE: "there is no vertex {word}; the file has {vertices} vertices, numbered from 0",
}


def read_vertex_rows(
    data: Bytes, position: int, rows: int, columns: tuple[bool, ...], wanted: tuple[int, int, int], name: str
) -> tuple[NDArray[np.float64], int]:
    """Read `rows` lines; returns the three wanted columns (rows, 3) and the place after.

    Parameters
    ----------
    columns : tuple of bool
        What stands in a line: a list (True) or a single number (False) each. More numbers may follow.
    wanted : 3 ints
        Columns of x, y, z.

    Raises
    ------
    InputError
        With the line of what is wrong. The caller has made sure that the file is long enough to hold the rows.
    """
    vertices, pending = np.empty((rows, 3)), pending_floats(3 * rows)
    target = np.where(columns, _LIST, _SKIPPED)
    target[list(wanted)] = range(3)
    status, position, n_pending = _vertex_rows(data, position, target, vertices, pending)
    if status != _OK:
        fail_at(data, position, name, _MESSAGES[status].format(word=shown(data, position)))
    resolve_floats(data, pending[:n_pending], vertices.reshape(-1), name)
    return vertices, position


def read_face_rows(
    data: Bytes, position: int, rows: int, before: tuple[bool, ...], n_vertices: int, name: str
) -> tuple[NDArray[np.int64], int]:
    """Read `rows` lines with a list of vertices each; returns triangles (m, 3) and the place after.

    Parameters
    ----------
    before : tuple of bool
        What stands before the list of vertices: a list (True) or a single number (False) each.

    Raises
    ------
    InputError
        With the line of what is wrong.
    """
    lists = np.array(before, np.bool_)
    status, where, n = _face_rows(data, position, rows, lists, n_vertices, np.empty((0, 3), np.int64), False)
    if status == _OK:
        faces = np.empty((n, 3), np.int64)
        status, where, _ = _face_rows(data, position, rows, lists, n_vertices, faces, True)
    if status != _OK:
        fail_at(data, where, name, _MESSAGES[status].format(word=shown(data, where), vertices=n_vertices))
    return faces, where


def skip_rows(data: Bytes, position: int, rows: int, name: str) -> int:
    """The place after `rows` lines."""
    position, missing = _skip_rows(data, position, rows)
    if missing:
        fail_at(data, data.size, name, "the file ends before the last line that its header announces")
    return int(position)


@jit
def _next_row(data: Bytes, i: int) -> int:
    """First word from i on; empty lines and lines of comment are passed over."""
    i = skip_blanks(data, i)
    while i < data.size and (data[i] == _NEWLINE or data[i] == _HASH):
        i = skip_blanks(data, skip_line(data, i))
    return i


@jit
def _line_ends(data: Bytes, i: int) -> bool:
    return i >= data.size or data[i] == _NEWLINE or data[i] == _HASH


@jit
def _skip_rows(data: Bytes, i: int, rows: int) -> tuple[int, int]:
    while rows > 0:
        i = _next_row(data, i)
        if i >= data.size:
            break
        i = skip_line(data, i)
        rows -= 1
    return i, rows


@jit
def _vertex_rows(
    data: Bytes, i: int, target: NDArray[np.int64], vertices: NDArray[np.float64], pending: NDArray[np.int64]
) -> tuple[int, int, int]:
    p = 0
    for row in range(vertices.shape[0]):
        i = _next_row(data, i)
        if i >= data.size:
            return _CUT_OFF, i, p
        for c in range(target.size):
            if _line_ends(data, i):
                return _SHORT_ROW, i, p
            if target[c] >= 0:
                value, end, exact = scan_float(data, i)
                vertices[row, target[c]] = value
                if not exact:
                    pending[p, 0], pending[p, 1], pending[p, 2] = 3 * row + target[c], i, end
                    p += 1
            elif target[c] == _LIST:
                length, end, found = scan_index(data, i)
                if not found or length < 0:
                    return _NO_INTEGER, i, p
                for _ in range(length):
                    end = skip_blanks(data, end)
                    if _line_ends(data, end):
                        return _SHORT_ROW, i, p
                    end = skip_token(data, end)
            else:
                end = skip_token(data, i)
            i = skip_blanks(data, end)
        i = skip_line(data, i)
    return _OK, i, p


@jit
def _face_rows(
    data: Bytes, i: int, rows: int, lists: NDArray[np.bool_], n_vertices: int, faces: NDArray[np.int64], fill: bool
) -> tuple[int, int, int]:
    m = 0
    for _ in range(rows):
        i = _next_row(data, i)
        if i >= data.size:
            return _CUT_OFF, i, m
        corners, start = 0, i
        for c in range(lists.size + 1):
            length = 1
            if c == lists.size or lists[c]:
                start = i
                length, end, found = scan_index(data, i)
                if not found or length < 0:
                    return (_SHORT_ROW if _line_ends(data, i) else _NO_INTEGER), i, m
                i = skip_blanks(data, end)
            if c == lists.size:
                corners = length
            else:
                for _ in range(length):
                    if _line_ends(data, i):
                        return _SHORT_ROW, i, m
                    i = skip_blanks(data, skip_token(data, i))
        if corners < 3:
            return _SHORT_FACE, start, m
        if not fill:
            # A line too short for its corners is found now, before anything is allocated for them.
            if 2 * corners > skip_line(data, i) - i:
                return _SHORT_ROW, start, m
            m += corners - 2
        else:
            first, last = 0, 0
            for k in range(corners):
                if _line_ends(data, i):
                    return _SHORT_ROW, i, m
                index, end, found = scan_index(data, i)
                if not found:
                    return _NO_INTEGER, i, m
                if index < 0 or index >= n_vertices:
                    return _OUT_OF_RANGE, i, m
                if k == 0:
                    first = index
                elif k > 1:
                    faces[m, 0], faces[m, 1], faces[m, 2] = first, last, index
                    m += 1
                last = index
                i = skip_blanks(data, end)
        i = skip_line(data, i)
    return _OK, i, m
