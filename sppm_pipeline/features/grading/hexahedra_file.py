"""Meshes of hexahedra in the files of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.formats.element_file import read_elements

MAX_ELEMENTS = 100_000


class Hexahedra(NamedTuple):
    """Elements of a file."""

    points: F64  # (n, 3) in the unit of the file
    elements: I64  # (m, 8) corners, in VTK's order if the file is right


def read_hexahedra(path: Path) -> Hexahedra:
    """Read the hexahedra of a VTU, VTK, Abaqus INP or Gmsh MSH file; of quadratic ones the corners.

    An error says that there are none, too many, other solid elements beside them, or nodes that are no points.
    """
    read = read_elements(path, "write the mesh again, perhaps as VTU")
    blocks = [np.asarray(block.data, np.int64) for block in read.cells if block.type.startswith("hexahedron")]
    points = np.asarray(read.points, np.float64)
    if not any(len(block) for block in blocks) or points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path.name} holds no hexahedra in space")
    others = {b.type: len(b.data) for b in read.cells if not b.type.startswith("hexahedron") and b.dim > 2}
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
