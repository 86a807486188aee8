"""Numbers for the pieces, and which of them stand at a lattice site.

A *site* is a place of the lattice of cells: its cell, if there is one, and the faces in its three low planes. Every
face belongs to exactly one site, which is how shared faces are counted once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.assembly.pieces import Pieces
from sppm_pipeline.numerics.assembly.tiling_arrays import TilingArrays
from sppm_pipeline.numerics.kernels.kernels import Kernels

#: An interior, three faces, six connectors.
PIECES_A_SITE = 10


class PieceNumbers(NamedTuple):
    """All pieces in one list, and the place of each in it.

    Attributes
    ----------
    kernels : list of Kernels
        The pieces.
    interior : (K + 1,) int32
        Number of interior t; the last entry, reached by t = -1, is -1 (none).
    face : (3, c + 1) int32
        Number of the face of an axis and a color; color -1 gives -1.
    connector : (K + 1, 3, 2, c + 1) int32
        Number of the connectors of interior, axis, side, color; -1 = none.
    """

    kernels: list[Kernels]
    interior: NDArray[np.int32]
    face: NDArray[np.int32]
    connector: NDArray[np.int32]


class Sites(NamedTuple):
    """A box of lattice sites, first <= site < stop, in index order z, y, x.

    Attributes
    ----------
    first, stop : (3,) int64
        Corners, x, y, z.
    interior : (sz, sy, sx) int32
        Interior of the cell, -1 = no cell.
    low, high : (3, sz, sy, sx) int32
        Colors of the low and high face of each axis, -1 = none; `high` is -1 where there is no cell.
    """

    first: NDArray[np.int64]
    stop: NDArray[np.int64]
    interior: NDArray[np.int32]
    low: NDArray[np.int32]
    high: NDArray[np.int32]


def number_pieces(pieces: Pieces) -> PieceNumbers:
    """Number the pieces: interiors, then faces by axis and color, then connectors by their key."""
    interiors, colors = len(pieces.interiors), pieces.colors
    kernels = list(pieces.interiors)
    interior = np.full(interiors + 1, -1, dtype=np.int32)
    interior[:interiors] = np.arange(interiors)
    face = np.full((3, colors + 1), -1, dtype=np.int32)
    for axis in range(3):
        face[axis, :colors] = len(kernels) + np.arange(colors)
        kernels.extend(pieces.faces[axis])
    connector = np.full((interiors + 1, 3, 2, colors + 1), -1, dtype=np.int32)
    for key in sorted(pieces.connectors):
        connector[key] = len(kernels)
        kernels.append(pieces.connectors[key])
    return PieceNumbers(kernels, interior, face, connector)


def sites_between(tiling: TilingArrays, first: NDArray[np.int64], stop: NDArray[np.int64]) -> Sites:
    """The sites first <= site < stop, clipped to where the tiling has any; only these are looked at."""
    shape = np.array(tiling.shape)
    if not tiling.periodic:
        # The faces in the last lattice planes belong to sites without a cell.
        first, stop = np.maximum(first, 0), np.minimum(stop, shape + 1)
    stop = np.maximum(first, stop)
    index = [np.arange(first[a], stop[a]) for a in range(3)]
    inside = [np.ones(len(i), dtype=bool) if tiling.periodic else i < shape[a] for a, i in enumerate(index)]
    wrapped = [i % shape[a] if tiling.periodic else np.minimum(i, shape[a] - 1) for a, i in enumerate(index)]
    cell = inside[0][:, None, None] & inside[1][:, None] & inside[2]
    low, high = [], []
    for axis, faces in enumerate(tiling.faces):
        across = inside.copy()
        across[axis] = np.ones_like(inside[axis])
        plane = wrapped.copy()
        plane[axis] = index[axis] % shape[axis] if tiling.periodic else index[axis]
        exists = across[0][:, None, None] & across[1][:, None] & across[2]
        low.append(np.where(exists, faces[np.ix_(*plane)], -1))
        plane[axis] = wrapped[axis] + 1
        high.append(np.where(cell, faces[np.ix_(*plane)], -1))
    interior = np.where(cell, tiling.interior[np.ix_(*wrapped)], -1)
    high = [np.where(interior >= 0, faces, -1) for faces in high]
    order = (0, 3, 2, 1)
    return Sites(
        first,
        stop,
        np.ascontiguousarray(interior.transpose(2, 1, 0), dtype=np.int32),
        np.ascontiguousarray(np.array(low).transpose(order), dtype=np.int32),
        np.ascontiguousarray(np.array(high).transpose(order), dtype=np.int32),
    )


def site_pieces(numbers: PieceNumbers, sites: Sites) -> NDArray[np.int32]:
    """Numbers of the pieces at each site, -1 = none.

    Returns
    -------
    (sz, sy, sx, 10) int32
        Interior, low faces of x, y, z, then the connectors by axis and side.
    """
    found = np.empty((*sites.interior.shape, PIECES_A_SITE), dtype=np.int32)
    found[..., 0] = numbers.interior[sites.interior]
    for axis in range(3):
        found[..., 1 + axis] = numbers.face[axis][sites.low[axis]]
        found[..., 4 + 2 * axis] = numbers.connector[sites.interior, axis, 0, sites.low[axis]]
        found[..., 5 + 2 * axis] = numbers.connector[sites.interior, axis, 1, sites.high[axis]]
    return found
