"""Detection of mesh formats: the extension of a file decides, its content must agree."""

from __future__ import annotations

import io
from pathlib import PurePath
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import InputError, did_you_mean
from sppm_pipeline.features.files.formats import glb, obj, off, three_mf
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats import ply, stl
from sppm_pipeline.services.formats.input_file import third_party_reader
from sppm_pipeline.services.formats.mesh_arrays import (
    DecodedMesh,
    Groups,
    require_content,
    require_faces,
    require_sound,
)

#: The readers and writers of meshes by extension.
FORMATS = {"stl": stl, "obj": obj, "ply": ply, "off": off, "glb": glb, "3mf": three_mf}

CAD = ("step", "stp", "iges", "igs", "brep", "x_t", "sldprt", "ipt", "f3d", "fcstd", "3dm", "blend")
"""Extensions of models whose surfaces are formulas, or that only one program reads."""

_OTHER_CONTENT = {
    b"PK\x03\x04": "a zip archive",
    b"\x89PNG": "a PNG image",
    b"\x1f\x8b": "a gzip archive",
    b"%PDF": "a PDF document",
    b"<": "an XML or HTML document",
    b"{": "a JSON document",
    b"ISO-10303-21": "a STEP file",
    b"version https://git-lfs": "a Git LFS pointer, not the file itself",
}
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"  # of UTF-8; it would hide the first word of a text
_OBJ_WORDS = {b"v", b"vn", b"vt", b"vp", b"f", b"l", b"o", b"g", b"s", b"mtllib", b"usemtl"}


# Meshes in formats that only trimesh reads: their size is bounded, and what comes out of it is checked. The formats
# with a reader of their own are not left to it: it counts on the lengths that a file states, and passes over what it
# does not know (sparse values and triangle fans of glTF, supports and units of 3MF). To check a file first and have
# trimesh read its tables afterwards takes more code, time and memory than to read them.
MAX_BYTES = 2**28
"""Bytes of a file in a format that only trimesh knows."""

_NOT_READ = {
    "zip", "tar.gz", "tar.bz2", "bz2", "3dxml",  # archives, which unpack to any size
    "gltf", "xdmf", "xmf", "dato", "post", "med", "cgns", "exo", "e", "ex2", "h5m", "hmf",  # name or need other files
    "dxf", "svg", "wkt", "xyz", "stl_ascii", "node", "ele", "dat", "xml",  # no surfaces, or no names of a format
}  # fmt: skip


def format_of_name(name: str) -> str:
    """The format that the extension of a file name stands for, in lower case.

    InputError if it is none of `FORMATS`, and trimesh does not read it on this machine either.
    """
    extension = PurePath(name).suffix[1:].lower()
    if extension == "gltf":
        raise InputError(f"{name}: glTF spread over several files is not read", hint="export it as GLB, in one file")
    if extension in CAD:
        by_plugin = ""
        if extension in CAD[:4]:
            by_plugin = (
                "`read.cad` of the plugin sppm-cad reads it, with its faces (pip install 'sppm-pipeline[cad]'); or "
            )
        raise InputError(
            f"{name}: a .{extension} file holds a CAD model, not triangles",
            hint=f"{by_plugin}export it from the CAD program as STL or 3MF",
        )
    if extension not in FORMATS and extension not in others():
        raise InputError(
            f"{name}: the extension {'.' + extension if extension else '(none)'} is no mesh format",
            hint=did_you_mean(f".{extension}", [f".{known}" for known in FORMATS]),
        )
    return extension


def sniff(data: bytes | memoryview | bytearray) -> str | None:
    """Guess the format from the content: a key of `FORMATS`, a description of something else, or None if unclear."""
    head = bytes(data[:4096])
    if head[:4] == b"glTF":
        return "glb"
    # a ZIP lists its entries at its end: there a 3MF names its model
    if head[:4] == b"PK\x03\x04" and b".model" in bytes(data[-65536:]).lower():
        return "3mf"
    if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return "text in UTF-16; save it as plain text (ASCII or UTF-8)"
    if head[:4] in (b"ply\n", b"ply\r") or head[:4] == b"ply ":
        return "ply"
    # after the formats with a signature, as a binary STL has none but the fit of its length
    if stl.is_binary(data) or stl.is_ascii(data):
        return "stl"
    for line in head.splitlines():
        words = line.split(b"#", 1)[0].split()
        if words:
            if words[0].endswith(b"OFF") and len(words[0]) <= 6:
                return "off"
            if words[0] in _OBJ_WORDS:
                return "obj"
            break
    for start, description in _OTHER_CONTENT.items():
        if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(start):
            return description
    return None


class MeshFile(NamedTuple):
    """The contents of a mesh file."""

    vertices: F64  # (n, 3), in the unit and with the axes of the file
    faces: I64  # (m, 3)
    unit: str | None  # that the file or its format states; None for the formats that have none
    mm: float  # that unit in millimeters; 1 if there is none
    up: str  # the axis that points up by the format's specification, "y" for GLB; else "z", as in printing
    groups: Groups = ()  # named stretches of the triangles, as far as the format has them (OBJ, 3MF, ASCII STL)


def decode_mesh(data: bytes | memoryview | bytearray, name: str) -> DecodedMesh:
    """Read a mesh in the format that the extension of `name` stands for: vertices (n, 3), faces (m, 3) int64.

    `data` is the content of the file, which messages call `name`. Vertices are in millimeters where the file states a
    unit (3MF, GLB), else the numbers of the file. InputError if the extension is unknown, the content is of another
    format, or it is broken, with the line, byte or part of what is wrong.
    """
    mesh = decode_mesh_file(data, name)
    with np.errstate(over="ignore"):
        vertices = mesh.vertices if mesh.mm == 1 else mesh.vertices * mesh.mm
    if not np.isfinite(vertices).all():
        raise InputError(f"{name}: coordinates of this size, in {mesh.unit}, are beyond all numbers in millimeters")
    return vertices, mesh.faces


def decode_mesh_file(data: bytes | memoryview | bytearray, name: str) -> MeshFile:
    """`decode_mesh` with the numbers as they stand in the file, and what they mean; raises the same."""
    expected = format_of_name(name)
    require_content(data, name)
    if bytes(data[:3]) == _BYTE_ORDER_MARK:
        data = memoryview(data)[3:]
        require_content(data, name)
    # the extension decides, but a file that is something else by its content is a mistake to be named
    found = sniff(data)
    if expected not in FORMATS:
        (vertices, faces), unit, mm = decode_other(data, name, expected)
        return MeshFile(vertices, faces, unit, mm, "z")
    if found in FORMATS and found != expected:
        raise InputError(
            f"{name}: this file is named .{expected} but is {'an' if found in ('obj', 'off') else 'a'} {found.upper()}",
            hint=f"rename it to {PurePath(name).with_suffix('.' + found).name}",
        )
    if found is not None and found not in FORMATS:
        raise InputError(f"{name}: this file is named .{expected} but is {found}")
    if expected == "3mf":
        (vertices, faces), unit, mm, groups = three_mf.decode_with_unit(data, name)
        return MeshFile(vertices, faces, unit, mm, "z", groups)
    if expected in ("obj", "stl"):
        (vertices, faces), groups = (obj if expected == "obj" else stl).decode_with_groups(data, name)
        return MeshFile(vertices, faces, None, 1.0, "z", groups)
    vertices, faces = FORMATS[expected].decode(data, name)
    if expected == "glb":
        return MeshFile(vertices, faces, "meter", 1000.0, "y")
    return MeshFile(vertices, faces, None, 1.0, "z")


def others() -> set[str]:
    """The extensions that trimesh reads on this machine beyond our own, without dots; some by optional libraries."""
    import trimesh

    return set(trimesh.available_formats()) - _NOT_READ


def decode_other(data: bytes | memoryview | bytearray, name: str, kind: str) -> tuple[DecodedMesh, str | None, float]:
    """Read a mesh in another format, DAE or STEP for instance, as one mesh: ((n, 3), (m, 3)), its unit, and that in mm.

    The unit is None, and 1 mm, if trimesh knows of none. InputError if the file is larger than `MAX_BYTES`, or trimesh
    fails.
    """
    if len(data) > MAX_BYTES:
        raise InputError(
            f"{name} has {len(data)} bytes; of a .{kind} file {MAX_BYTES} are read at most",
            hint="convert it to .stl, .ply or .3mf",
        )
    with third_party_reader("trimesh", name, "convert it to .stl, .ply or .3mf"):
        import trimesh

        # `process=False`: vertices stay as the file has them, unmerged and in order
        scene = trimesh.load_scene(io.BytesIO(bytes(data)), file_type=kind, process=False)
        mesh, unit = scene.to_mesh(), scene.units
        mm = float(trimesh.units.unit_conversion(unit, "millimeters")) if unit else 1.0
        arrays = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    vertices, faces = require_sound(name, "its mesh", *arrays)
    require_faces(name, faces)
    return (vertices, faces), unit, mm
