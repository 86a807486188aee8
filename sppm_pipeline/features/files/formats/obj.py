"""Wavefront OBJ: positions and faces of the text format; everything else in it is skipped."""

from __future__ import annotations

from array import array
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.formats.decimals import Words, decimal_scale, face_rows, vertex_rows
from sppm_pipeline.services.formats.encoding import InPieces, as_written, in_blocks
from sppm_pipeline.services.formats.mesh_arrays import DecodedMesh, GroupLog, Groups, decoded, require_content
from sppm_pipeline.services.formats.text import Lines, fan, shown

_HEAD = b"# OBJ written by sppm\n"
_NAMES = {b"o": "object", b"g": "group", b"usemtl": "material"}
_VERTEX, _FACE = Words.of(b"v ", b" ", b" ", b"\n"), Words.of(b"f ", b" ", b" ", b"\n")


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh without its groups; see `decode_with_groups`."""
    return decode_with_groups(data, name)[0]


def decode_with_groups(data: bytes | memoryview | bytearray, name: str) -> tuple[DecodedMesh, Groups]:
    """Read a mesh, and the triangles of its objects, groups and materials; vertices keep the order of the file.

    Polygons are cut into fans; relative (negative) vertex numbers, ``a/b/c`` corners, colors behind the coordinates,
    comments and continued lines are understood. Every face of the file is taken, whatever object or group it is in.
    See `detect.decode_mesh` for what all readers take, return and raise.
    """
    require_content(data, name)
    lines = Lines(data, name, continued=True)
    coordinates, corners, named = array("d"), array("q"), GroupLog()
    for words in lines:
        if words[0] == b"v":
            if len(words) < 4:
                lines.fail("a vertex has three coordinates")
            coordinates.extend(lines.floats(words[1:4]))
    total, above = len(coordinates) // 3, 0
    for words in lines:  # a face may name vertices that follow it
        if words[0] == b"v":
            above += 1
        elif words[0] == b"f":
            if len(words) < 4:
                lines.fail("a face has at least three corners")
            corners.extend(fan([_vertex(lines, word, above, total) for word in words[1:]]))
        elif words[0] in _NAMES:
            named.begin(_NAMES[words[0]], words[1:], len(corners) // 3)
    return decoded(name, coordinates, corners), named.groups(len(corners) // 3)


def _vertex(lines: Lines, word: bytes, above: int, total: int) -> int:
    """The vertex of a corner, numbered from 0; a negative number counts back from the face."""
    number = word.partition(b"/")[0]
    index = lines.integer(number)
    if index is None:
        lines.fail(f"a corner of a face is a vertex number, perhaps with /texture/normal, not {shown(number)}", word)
    index = above + index if index < 0 else index - 1
    if not 0 <= index < total:
        lines.fail(
            f"there is no vertex {shown(number)}; the file has {total} vertices (vertex numbers start at 1)", word
        )
    return index


def encode(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], *, threads: int = 1
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) and (m, 3), piece by piece.

    Coordinates are rounded to 5e-10 of the power of ten above the largest one. Same mesh, same bytes.
    """
    mesh = as_written(vertices, faces)
    scale = decimal_scale(mesh.largest)
    yield _HEAD
    points, faces, _ = mesh
    yield from in_blocks(len(points), lambda rows: vertex_rows(points[rows], scale, _VERTEX), threads, points)
    yield from in_blocks(len(faces), lambda rows: face_rows(faces[rows], 1, _FACE), threads, faces)


def in_pieces(vertices: int, faces: int, reach: tuple[float, float]) -> InPieces | None:
    """See `ply.in_pieces`."""
    scale = decimal_scale(reach[1])
    if decimal_scale(reach[0]) != scale:
        return None
    return InPieces(
        _HEAD,
        lambda points, known, _: vertex_rows(points[known:], scale, _VERTEX),
        lambda corners: face_rows(corners, 1, _FACE),
        fits=lambda largest: np.isfinite(largest) and decimal_scale(largest) == scale,
    )
