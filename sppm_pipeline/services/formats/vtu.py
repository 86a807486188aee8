"""VTK's formats for unstructured grids: VTU (XML with binary data appended) and the legacy format.

Both are read by ParaView, PyVista and meshio; the legacy one is for programs that do not read VTU.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F32, I32
from sppm_pipeline.services.formats.volume_arrays import as_written

VTK_TYPES = {4: 10, 10: 24}
"""VTK's number of straight and quadratic tetrahedra, by the nodes of a cell; its order of nodes is the same as here."""

_HEXAHEDRON, _HEXAHEDRON_NODES = 12, (0, 1, 3, 2, 4, 5, 7, 6)
"""VTK goes around the lower face, then around the upper one."""

_BLOCK = 1 << 16
_NAMES = {"float64": "Float64", "float32": "Float32", "int32": "Int32", "int64": "Int64", "uint8": "UInt8"}


def encode(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer], compress: bool = False
) -> Iterator[bytes]:
    """A VTU file, piece by piece: little-endian, 64-bit sizes, a cell array ``material``.

    Quadratic cells (m, 10) have mid-edge nodes in the order 01, 12, 02, 03, 13, 23, which is VTK's. Data compressed
    with zlib may differ between versions of that library.
    """
    points, corners, materials = as_written(nodes, cells, materials)
    return _encoded(points, corners, VTK_TYPES[corners.shape[1]], {"material": materials}, compress)


def encode_hexahedra(nodes: F32, cells: I32, data: Mapping[str, NDArray[Any]]) -> Iterator[bytes]:
    """A VTU file of hexahedra, piece by piece.

    Parameters
    ----------
    nodes : (n, 3) float32
    cells : (m, 8) int32
        Column i + 2 j + 4 k is the corner at the upper end along x, y, z where i, j, k is 1.
    data : mapping of str to (m,) array
        Cell arrays: float32, int32 or uint8.
    """
    return _encoded(nodes, cells[:, _HEXAHEDRON_NODES], _HEXAHEDRON, data, False)


def _encoded(
    points: NDArray[np.floating], corners: I32, kind: int, data: Mapping[str, NDArray[Any]], compress: bool
) -> Iterator[bytes]:
    count, per_cell = corners.shape
    arrays = {
        "points": points.astype(points.dtype.newbyteorder("<"), copy=False),
        "connectivity": np.ascontiguousarray(corners, "<i4"),
        "offsets": np.arange(per_cell, (count + 1) * per_cell, per_cell, dtype="<i8"),
        "types": np.full(count, kind, np.uint8),
        **{name: values.astype(values.dtype.newbyteorder("<"), copy=False) for name, values in data.items()},
    }
    blocks, places, end = {}, {}, 0
    for name, array in arrays.items():
        blocks[name] = _compressed(array) if compress else _plain(array)
        places[name] = end
        end += sum(len(piece) for piece in blocks[name])

    def declared(name: str, components: int = 1) -> str:
        kind = _NAMES[arrays[name].dtype.newbyteorder("=").name]
        more = f' NumberOfComponents="{components}"' if components > 1 else ""
        return f'<DataArray type="{kind}" Name="{name}"{more} format="appended" offset="{places[name]}"/>\n'

    compressor = ' compressor="vtkZLibDataCompressor"' if compress else ""
    yield (
        '<?xml version="1.0"?>\n'
        f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"{compressor}>\n'
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">\n'
        f"<Points>\n{declared('points', 3)}</Points>\n"
        f"<Cells>\n{declared('connectivity')}{declared('offsets')}{declared('types')}</Cells>\n"
        f'<CellData Scalars="{next(iter(data))}">\n{"".join(map(declared, data))}</CellData>\n'
        '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    ).encode()
    for pieces in blocks.values():
        yield from pieces
    yield b"\n</AppendedData>\n</VTKFile>\n"


def encode_legacy(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], materials: NDArray[np.integer]
) -> Iterator[bytes]:
    """A legacy VTK file (version 3.0), piece by piece: big-endian, a cell array ``material``; see `encode`."""
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


def _plain(array: NDArray[np.generic]) -> list[bytes]:
    return [np.array([array.nbytes], "<u8").tobytes(), array.tobytes()]


def _compressed(array: NDArray[np.generic]) -> list[bytes]:
    """Blocks of 64 KiB; in front their number, size, the size of the last if it is smaller, and what each became."""
    data = array.tobytes()
    packed = [zlib.compress(data[start : start + _BLOCK], 6) for start in range(0, len(data), _BLOCK)]
    header = [len(packed), _BLOCK, len(data) % _BLOCK, *(len(piece) for piece in packed)]
    return [np.array(header, "<u8").tobytes(), *packed]
