"""VTK's format for unstructured grids, VTU: XML with binary data appended."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

VTK_TYPES = {4: 10, 8: 12, 10: 24}
"""VTK's number of straight tetrahedra, hexahedra and quadratic tetrahedra, by the nodes of a cell."""

_HEXAHEDRON = (0, 1, 3, 2, 4, 5, 7, 6)
"""VTK goes around the lower face, then around the upper one; its order of nodes of tetrahedra is the same as here."""

_BLOCK = 1 << 16
_NAMES = {"float64": "Float64", "float32": "Float32", "int32": "Int32", "int64": "Int64", "uint8": "UInt8"}


def encode_cells(
    nodes: NDArray[np.floating], cells: NDArray[np.integer], data: Mapping[str, NDArray[Any]], *, compress: bool = False
) -> Iterator[bytes]:
    """A VTU file of cells of one kind, piece by piece: little-endian, 64-bit sizes.

    Parameters
    ----------
    nodes : (n, 3) float32 or float64
    cells : (m, 8), (m, 4) or (m, 10) int
        Of hexahedra, column i + 2 j + 4 k is the corner at the upper end along x, y, z where i, j, k is 1. The mid-edge
        nodes of quadratic tetrahedra follow their corners in the order 01, 12, 02, 03, 13, 23.
    data : mapping of str to (m,) array
        Cell arrays: float32, int32 or uint8.
    compress : bool
        Compress by zlib: the bytes may differ between versions of that library.
    """
    count, per_cell = cells.shape
    corners = cells[:, _HEXAHEDRON] if per_cell == 8 else cells
    arrays = {
        "points": nodes.astype(nodes.dtype.newbyteorder("<"), copy=False),
        "connectivity": np.ascontiguousarray(corners, "<i4"),
        "offsets": np.arange(per_cell, (count + 1) * per_cell, per_cell, dtype="<i8"),
        "types": np.full(count, VTK_TYPES[per_cell], np.uint8),
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
        f'<UnstructuredGrid>\n<Piece NumberOfPoints="{len(nodes)}" NumberOfCells="{count}">\n'
        f"<Points>\n{declared('points', 3)}</Points>\n"
        f"<Cells>\n{declared('connectivity')}{declared('offsets')}{declared('types')}</Cells>\n"
        f'<CellData Scalars="{next(iter(data))}">\n{"".join(map(declared, data))}</CellData>\n'
        '</Piece>\n</UnstructuredGrid>\n<AppendedData encoding="raw">\n_'
    ).encode()
    for pieces in blocks.values():
        yield from pieces
    yield b"\n</AppendedData>\n</VTKFile>\n"


def _plain(array: NDArray[np.generic]) -> list[bytes]:
    return [np.array([array.nbytes], "<u8").tobytes(), array.tobytes()]


def _compressed(array: NDArray[np.generic]) -> list[bytes]:
    """Blocks of 64 KiB; in front their number, size, the size of the last if it is smaller, and what each became."""
    data = array.tobytes()
    packed = [zlib.compress(data[start : start + _BLOCK], 6) for start in range(0, len(data), _BLOCK)]
    header = [len(packed), _BLOCK, len(data) % _BLOCK, *(len(piece) for piece in packed)]
    return [np.array(header, "<u8").tobytes(), *packed]
