"""VTK's formats: VTU, and the legacy format for programs that do not read it. ParaView, PyVista and meshio do."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats import encode_cells
from sppm_tetrahedra.formats.volume_arrays import as_written

_TYPES = {4: 10, 10: 24}
"""VTK's number of straight and quadratic tetrahedra, by the nodes of a cell; its order of nodes is the same as here."""


def encode(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer], compress: bool = False
) -> Iterator[bytes]:
    """A VTU file, piece by piece, with a cell array ``material``; see `sppm_pipeline.formats.encode_cells`."""
    points, corners, materials = as_written(nodes, cells, materials)
    return encode_cells(points, corners, {"material": materials}, compress=compress)


def encode_legacy(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer]
) -> Iterator[bytes]:
    """A legacy VTK file (version 3.0), piece by piece: big-endian, a cell array ``material``."""
    points, corners, materials = as_written(nodes, cells, materials)
    count, per_cell = corners.shape
    yield b"# vtk DataFile Version 3.0\ntetrahedra\nBINARY\nDATASET UNSTRUCTURED_GRID\n"
    yield f"POINTS {len(points)} double\n".encode()
    yield points.astype(">f8").tobytes()
    yield f"\nCELLS {count} {count * (per_cell + 1)}\n".encode()
    lists = np.empty((count, per_cell + 1), ">i4")
    lists[:, 0], lists[:, 1:] = per_cell, corners
    yield lists.tobytes()
    yield f"\nCELL_TYPES {count}\n".encode()
    yield np.full(count, _TYPES[per_cell], ">i4").tobytes()
    yield f"\nCELL_DATA {count}\nSCALARS material int 1\nLOOKUP_TABLE default\n".encode()
    yield materials.astype(">i4").tobytes()
    yield b"\n"
