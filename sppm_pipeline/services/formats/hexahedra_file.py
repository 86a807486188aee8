"""Meshes of hexahedra in the files of other programs, read by meshio."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats.input_file import library, require_file, third_party_reader

READERS = {".vtu": "vtu", ".vtk": "vtk", ".inp": "abaqus", ".msh": "gmsh"}
"""Modules of meshio by the suffix of a file."""

LARGEST_FILE = 2 * 2**30
"""Bytes; larger files are refused before they are read."""

MAX_ELEMENTS = 100_000

IGNORED = {"vertex", "line", "line3", "triangle", "triangle6", "quad", "quad8", "quad9"}
"""Elements of lower dimension, which boundary conditions use."""


class Hexahedra(NamedTuple):
    """Elements of a file."""

    points: F64  # (n, 3) in the unit of the file
    elements: I64  # (m, 8) corners, in VTK's order if the file is right


def read_hexahedra(path: Path) -> Hexahedra:
    """Read the hexahedra of a VTU, VTK, Abaqus INP or Gmsh MSH file; of quadratic ones the corners.

    An error says that there are none, too many, other solid elements beside them, or nodes that are no points.
    """
    require_file(path, LARGEST_FILE)
    reader = library(f"meshio.{READERS[path.suffix.lower()]}", "volume")
    with third_party_reader("meshio", path.name, "write the mesh again, perhaps as VTU"):
        read = reader.read(path)
    blocks = [np.asarray(block.data, np.int64) for block in read.cells if block.type.startswith("hexahedron")]
    points = np.asarray(read.points, np.float64)
    if not any(len(block) for block in blocks) or points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path.name} holds no hexahedra in space")
    others = {b.type: len(b.data) for b in read.cells if not b.type.startswith("hexahedron") and b.type not in IGNORED}
    if others:
        raise InputError(
            f"{path.name} holds {', '.join(f'{n} elements of type {kind}' for kind, n in others.items())} beside "
            "hexahedra; cells can fill hexahedra alone",
            hint="mesh the part with hexahedra, or fill it by `tile.scattered`",
        )
    elements = np.concatenate([block[:, :8] for block in blocks])
    if len(elements) > MAX_ELEMENTS:
        raise InputError(f"{path.name} has {len(elements)} elements; the limit is {MAX_ELEMENTS}")
    if elements.min() < 0 or elements.max() >= len(points):
        raise InputError(f"{path.name}: an element names a node that does not exist")
    if not np.isfinite(points[np.unique(elements)]).all():
        raise InputError(f"{path.name}: nodes of hexahedra are no finite points in space")
    return Hexahedra(points, elements)
