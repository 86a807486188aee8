"""GLB, the binary form of glTF 2.0: one mesh of all that its scene shows, in meters, y up, as the specification says.

Materials, textures and animations are skipped. Compressed meshes and data outside of the file are refused. What is
placed where is determined here, with the checks that libraries leave out.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.features.files.formats.gltf import Entry, read_document, read_meshes
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.formats.encoding import as_written, in_blocks, little_endian, require_float32
from sppm_pipeline.services.formats.mesh_arrays import (
    IDENTITY,
    MAX_PLACED,
    DecodedMesh,
    Matrix,
    after,
    place,
    require_content,
    require_faces,
)
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
    require_float32(mesh, "GLB")
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


def _turned(points: NDArray[np.floating]) -> F32:
    """From z up to y up."""
    turned = np.empty(points.shape, np.float32)
    turned[:, 0], turned[:, 1], turned[:, 2] = points[:, 0], points[:, 2], -points[:, 1]
    turned += np.float32(0)  # no -0
    return turned


def _vertex_normals(points: F64, faces: I32) -> F64:
    """Unit normals (n, 3); along z where the triangles have no area or cancel each other."""
    normals = np.zeros(points.shape)
    _sum_normals(points, faces, normals)
    lengths = np.sqrt((normals * normals).sum(axis=1))
    normals[lengths == 0] = [0.0, 0.0, 1.0]
    normals /= np.where(lengths > 0, lengths, 1.0)[:, None]
    return normals


@jit
def _sum_normals(points: F64, faces: I32, normals: F64) -> None:
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


_HEADER, _JSON, _BINARY = 12, 0x4E4F534A, 0x004E4942
_HARMLESS = ("KHR_materials_", "KHR_texture_", "EXT_texture_", "KHR_mesh_quantization", "KHR_lights_punctual")
_COMPRESSED = {"KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression"}


def decode(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read the scene of a file as one mesh, in meters and with y up, as it stands there.

    Vertices are split in such files where a texture or an edge needs it; those of equal position are merged in a mesh
    that is not closed as it is, the first one being kept. See `detect.decode_mesh` for what all readers take, return
    and raise.
    """
    require_content(data, name)
    # views of the file: nothing of its size is copied before it is checked
    text, binary = _chunks(memoryview(data).cast("B"), name)
    document = read_document(text, name)
    _require_readable(document)
    entries = document.entries("meshes")
    # each mesh is read once, however many nodes place it
    numbers: dict[int, int] = {}
    copies: list[tuple[int, Matrix]] = []
    for node, matrix in _nodes(document):
        which = node.integer("mesh")
        if which >= len(entries):
            node.fail(f"there is no mesh {which}; the file has {len(entries)}")
        _require_rigid(node)
        copies.append((numbers.setdefault(which, len(numbers)), matrix))
    mesh = place(name, read_meshes(document, binary, [entries[which] for which in numbers], name), copies)
    require_faces(name, mesh[1])
    return mesh


def _chunks(data: memoryview, name: str) -> tuple[bytes, memoryview]:
    """The JSON and the binary part."""
    if bytes(data[:4]) != b"glTF":
        raise InputError(f"{name}: a GLB file begins with glTF, not {bytes(data[:4])!r}")
    if len(data) < _HEADER:
        raise InputError(f"{name}: {len(data)} bytes are too few for a GLB", hint="the file is cut off")
    version, length = (int.from_bytes(data[k : k + 4], "little") for k in (4, 8))
    if version != 2:
        raise InputError(f"{name}: version {version} of glTF is not read, only 2", hint="export it as glTF 2.0")
    if length > len(data):
        raise InputError(
            f"{name}: the header claims {length} bytes, but the file has {len(data)}",
            hint="the file is cut off: write or download it again",
        )
    found: list[memoryview] = []
    position = _HEADER
    for wanted, word in ((_JSON, "JSON"), (_BINARY, "binary")):
        if position == length and found:
            break
        size, kind = (int.from_bytes(data[position + k : position + k + 4], "little") for k in (0, 4))
        if position + 8 + size > length:
            raise InputError(
                f"{name}: byte {position}: a chunk of {size} bytes begins here, but only "
                f"{max(0, length - position - 8)} follow",
                hint="the file is cut off or damaged",
            )
        if kind != wanted:
            if wanted == _BINARY:
                break  # a chunk of an extension; without a binary part there is no mesh, which the accessors will say
            raise InputError(f"{name}: byte {position}: the {word} chunk is expected here, not one of type {kind:#x}")
        found.append(data[position + 8 : position + 8 + size])
        position += 8 + (size + 3) // 4 * 4
    return bytes(found[0]), found[1] if len(found) > 1 else memoryview(b"")


def _require_readable(document: Entry) -> None:
    version = document.entry("asset").string("version")
    if not version.startswith("2"):
        document.fail(f"version {version[:20]!r} of glTF is not read, only 2", hint="export it as glTF 2.0")
    for extension in document.strings("extensionsRequired"):
        if extension in _COMPRESSED:
            document.fail(f"its meshes are compressed ({extension})", hint="export without compression")
        if not extension.startswith(_HARMLESS):
            document.fail(f"it requires the extension {extension[:60]!r}, which is not read")


def _nodes(document: Entry) -> list[tuple[Entry, Matrix]]:
    """The nodes of the scene that have a mesh, with their transformation, in the order of the tree."""
    nodes, scenes = document.entries("nodes"), document.entries("scenes")
    # before anything is made for each of them
    if len(nodes) > MAX_PLACED:
        document.fail(f"it has {len(nodes)} nodes; at most {MAX_PLACED} are read")
    children = [node.integers("children") for node in nodes]
    if scenes:
        number = document.integer("scene", 0)
        if number >= len(scenes):
            document.fail(f"there is no scene {number}; the file has {len(scenes)}")
        roots = scenes[number].integers("nodes")
    else:
        inner = {child for some in children for child in some}
        roots = [k for k in range(len(nodes)) if k not in inner]
    found: list[tuple[Entry, Matrix]] = []
    seen: set[int] = set()
    waiting: list[tuple[int, Matrix]] = [(root, IDENTITY) for root in reversed(roots)]
    while waiting:
        number, outer = waiting.pop()
        if number >= len(nodes):
            document.fail(f"there is no node {number}; the file has {len(nodes)}")
        # nodes form a forest: a second visit means two parents or a circle, which would never end
        if number in seen:
            nodes[number].fail("it has two parents, or is inside itself")
        seen.add(number)
        matrix = after(outer, _matrix(nodes[number]))
        if "mesh" in nodes[number]:
            found.append((nodes[number], matrix))
        waiting += [(child, matrix) for child in reversed(children[number])]
    return found


def _matrix(node: Entry) -> Matrix:
    """The transformation of a node: a matrix, stored column by column, or a shift after a turn after a scaling."""
    columns = node.numbers("matrix", 16)
    if columns is not None:
        whole = np.array(columns).reshape(4, 4).T
        if whole[3].tolist() != [0, 0, 0, 1]:
            node.fail("the last row of its matrix must be 0 0 0 1")
        return np.ascontiguousarray(whole[:3])
    shift, turn, scale = node.numbers("translation", 3), node.numbers("rotation", 4), node.numbers("scale", 3)
    if shift is None and turn is None and scale is None:
        return IDENTITY
    matrix = IDENTITY.copy()
    if turn is not None:
        length = float(np.hypot(np.hypot(turn[0], turn[1]), np.hypot(turn[2], turn[3])))
        # exporters round quaternions; what is farther off is no rotation
        if abs(length - 1) > 1e-2:
            node.fail(f"its rotation must be a unit quaternion, not {turn}")
        x, y, z, w = (value / length for value in turn)
        matrix[:, :3] = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    if scale is not None:
        with np.errstate(over="ignore"):
            matrix[:, :3] *= scale
    if shift is not None:
        matrix[:, 3] = shift
    return matrix


def _require_rigid(node: Entry) -> None:
    """Refuse what would move vertices in a way that is not read."""
    if "skin" in node:
        node.fail("its mesh is moved by a skeleton (skin)", hint="apply the pose and export a plain mesh")
    if any(node.numbers("weights", None) or []):
        node.fail("its mesh is deformed by morph targets", hint="apply the shape and export a plain mesh")
    if "EXT_mesh_gpu_instancing" in node.entry("extensions"):
        node.fail("it stands for many copies (EXT_mesh_gpu_instancing)", hint="export real copies")
