"""GLB files written: one mesh, in meters and with y up, and perhaps many nodes that place it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.services.formats.encoding import as_written, in_blocks, little_endian, within_float32
from sppm_pipeline.services.jit.compiled import jit

_METER = 1000.0  # mm
_FLOAT, _UINT, _ARRAY, _ELEMENTS = 5126, 5125, 34962, 34963  # codes of the specification
_MAX = 2**32 - 1


def encode(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    threads: int = 1,
    normals: bool = False,
    name: str = "mesh",
    offsets: NDArray[np.floating] | None = None,
) -> Iterator[bytes | memoryview]:
    """Write a mesh, (n, 3) in millimeters with z up and (m, 3), piece by piece. Same mesh, same bytes.

    Positions are turned, y up, and stored as float32 meters, as the specification requires. With `normals` each vertex
    gets one, the mean of its triangles' normals by area, so that viewers shade smoothly. With `offsets`, (k, 3) in mm,
    the mesh is written once and placed by k nodes. DesignError if the file would have 4 GiB or more, or a coordinate is
    beyond float32.
    """
    mesh = as_written(vertices, faces)
    within_float32(mesh, "GLB")
    points, triangles = _turned(mesh.points / _METER), mesh.faces
    arrays: list[NDArray[Any]] = [triangles, points]
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": _UINT, "count": int(triangles.size), "type": "SCALAR"},
        {
            "bufferView": 1,
            "componentType": _FLOAT,
            "count": len(points),
            "type": "VEC3",
            "min": points.min(axis=0).tolist(),
            "max": points.max(axis=0).tolist(),
        },
    ]
    attributes = {"POSITION": 1}
    if normals:
        arrays.append(_turned(_vertex_normals(np.asarray(mesh.points, np.float64), triangles)))
        accessors.append({"bufferView": 2, "componentType": _FLOAT, "count": len(points), "type": "VEC3"})
        attributes["NORMAL"] = 2
    views, size = [], 0
    for number, array in enumerate(arrays):
        target = _ELEMENTS if number == 0 else _ARRAY
        views.append({"buffer": 0, "byteOffset": size, "byteLength": array.nbytes, "target": target})
        size += array.nbytes
    places: list[list[float] | None] = [None]
    if offsets is not None:
        # in full precision, as copies must touch each other
        places = [[x / _METER, z / _METER, 0.0 - y / _METER] for x, y, z in np.asarray(offsets, np.float64).tolist()]
    document = {
        "asset": {"version": "2.0", "generator": "sppm"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(places)))}],
        "nodes": [{"mesh": 0} if place is None else {"mesh": 0, "translation": place} for place in places],
        "meshes": [{"name": name, "primitives": [{"attributes": attributes, "indices": 0, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": size}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + size
    if total > _MAX:
        raise DesignError(f"the file would have {total} bytes; a GLB holds up to 4 GiB", hint="write the mesh as PLY")
    yield b"glTF" + _word(2) + _word(total) + _word(len(text)) + b"JSON" + text + _word(size) + b"BIN\0"
    for array in arrays:
        yield from in_blocks(len(array), lambda rows, array=array: little_endian(array[rows]), 1)  # type: ignore[misc]


def _word(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _turned(points: NDArray[np.floating]) -> NDArray[np.float32]:
    """From z up to y up."""
    turned = np.empty(points.shape, np.float32)
    turned[:, 0], turned[:, 1], turned[:, 2] = points[:, 0], points[:, 2], -points[:, 1]
    turned += np.float32(0)  # no -0
    return turned


def _vertex_normals(points: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Unit normals (n, 3); along z where the triangles have no area or cancel each other."""
    normals = np.zeros(points.shape)
    _sum_normals(points, faces, normals)
    lengths = np.sqrt((normals * normals).sum(axis=1))
    normals[lengths == 0] = [0.0, 0.0, 1.0]
    normals /= np.where(lengths > 0, lengths, 1.0)[:, None]
    return normals


@jit
def _sum_normals(points: NDArray[np.float64], faces: NDArray[np.int32], normals: NDArray[np.float64]) -> None:
    for row in range(faces.shape[0]):
        a, b, c = faces[row, 0], faces[row, 1], faces[row, 2]
        ux, uy, uz = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        vx, vy, vz = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in range(3):
            vertex = faces[row, k]
            normals[vertex, 0] += nx
            normals[vertex, 1] += ny
            normals[vertex, 2] += nz
