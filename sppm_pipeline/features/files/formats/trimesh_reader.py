"""Meshes in formats that only the library trimesh reads: their size is bounded, and what comes out of it is checked.

The formats with a reader of their own are not left to it: it counts on the lengths that a file states, and passes over
what it does not know (sparse values and triangle fans of glTF, supports and units of 3MF). To check a file first and
have trimesh read its tables afterwards takes more code, time and memory than to read them.
"""

from __future__ import annotations

import io

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.input_file import third_party_reader
from sppm_pipeline.services.formats.mesh_arrays import DecodedMesh, require_faces, require_sound

MAX_BYTES = 2**28
"""Bytes of a file in a format that only trimesh knows."""

_NOT_READ = {
    "zip", "tar.gz", "tar.bz2", "bz2", "3dxml",  # archives, which unpack to any size
    "gltf", "xdmf", "xmf", "dato", "post", "med", "cgns", "exo", "e", "ex2", "h5m", "hmf",  # name or need other files
    "dxf", "svg", "wkt", "xyz", "stl_ascii", "node", "ele", "dat", "xml",  # no surfaces, or no names of a format
}  # fmt: skip


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
