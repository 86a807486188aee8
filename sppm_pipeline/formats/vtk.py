"""The legacy VTK format for unstructured grids, binary, for programs that do not read VTU."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.volume_arrays import as_written
from sppm_pipeline.formats.vtu import VTK_TYPES


def encode(nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer]) -> Iterator[bytes]:
    """A legacy VTK file (version 3.0), piece by piece: big-endian, with a cell array ``material``.

    Parameters
    ----------
    nodes : (n, 3) float
    cells : (m, 4) or (m, 10) integers
        Quadratic ones with mid-edge nodes in the order 01, 12, 02, 03, 13, 23, which is VTK's.
    materials : (m,) integers
    """
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
    yield np.full(count, VTK_TYPES[per_cell], ">i4").tobytes()
    yield f"\nCELL_DATA {count}\nSCALARS material int 1\nLOOKUP_TABLE default\n".encode()
    yield materials.astype(">i4").tobytes()
    yield b"\n"
