"""The pieces of a tiling (interiors, faces, connectors), their places, and which meet at a lattice site.

A *site* is a place of the lattice of cells: its cell, if there is one, and the faces in its three low planes. Every
face belongs to exactly one site, which is how shared faces are counted once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.kernels.kernels import Kernels


@dataclass(frozen=True, eq=False)
class Pieces:
    """Kernel sets from which every cell of a tiling is put together; all lengths in cell sizes.

    Attributes
    ----------
    interiors : tuple of K Kernels
        Pores and tunnels inside a cell, relative to its low corner.
    faces : tuple of 3 tuples of c Kernels
        ``faces[axis][color]``: pores and tunnels in the plane ``coordinate[axis] = 0``, relative to the low corner of
        the cell on the high side of the plane.
    connectors : mapping of (interior, axis, side, color) to Kernels
        Tunnels that join interior `interior` to the face of that color on its low (side 0) or high (side 1) side,
        relative to the low corner of the cell; those of side 1 end in the plane ``coordinate[axis] = 1``. Absent means
        none.
    """

    interiors: tuple[Kernels, ...]
    faces: tuple[tuple[Kernels, ...], tuple[Kernels, ...], tuple[Kernels, ...]]
    connectors: Mapping[tuple[int, int, int, int], Kernels]

    @property
    def colors(self) -> int:
        """Number of face colors, c."""
        return len(self.faces[0])

    def every(self) -> list[Kernels]:
        """All kernel sets."""
        return [*self.interiors, *(kernels for axis in self.faces for kernels in axis), *self.connectors.values()]


class TilingArrays(NamedTuple):
    """Content of a box of nx x ny x nz cells; cell (i, j, k) fills [i, i+1] x [j, j+1] x [k, k+1].

    Attributes
    ----------
    interior : (nx, ny, nz) int32
        Interior of each cell, -1 = no cell.
    faces : tuple of 3 int32 arrays
        ``faces[axis]`` has the shape of `interior`, but one more along `axis`: the color of the face in lattice
        plane i of that axis, which is the low side of cell i; -1 = no face.
    periodic : bool
        Everything repeats for ever, and the last plane of faces is the first one.
    """

    interior: NDArray[np.int32]
    faces: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
    periodic: bool

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells along x, y, z."""
        nx, ny, nz = self.interior.shape
        return nx, ny, nz


def lone_periodic_cell(interior: int = 0, colors: tuple[int, int, int] = (0, 0, 0)) -> TilingArrays:
    """One cell whose opposite faces are the same: a periodic tiling of 1 x 1 x 1 cells."""
    faces = []
    for axis in range(3):
        shape = [1, 1, 1]
        shape[axis] = 2
        faces.append(np.full(shape, colors[axis], dtype=np.int32))
    return TilingArrays(np.full((1, 1, 1), interior, dtype=np.int32), (faces[0], faces[1], faces[2]), True)


def check_tiling(tiling: TilingArrays, pieces: Pieces | None = None) -> None:
    """Check shapes, and with `pieces` that every interior and color exists.

    Raises
    ------
    ValueError
        If a shape is wrong, the first and last plane of faces of a periodic tiling differ, or a number names no
        piece.
    """
    shape = tiling.shape
    for axis, faces in enumerate(tiling.faces):
        expected = tuple(size + (a == axis) for a, size in enumerate(shape))
        if faces.shape != expected:
            raise ValueError(f"faces of axis {axis} have the shape {faces.shape}, expected {expected}")
        if tiling.periodic and (np.take(faces, 0, axis) != np.take(faces, -1, axis)).any():
            raise ValueError(f"the tiling is periodic, but the first and last faces of axis {axis} differ")
        if pieces is not None and faces.max(initial=-1) >= len(pieces.faces[axis]):
            raise ValueError(f"a face of axis {axis} has color {faces.max()}, of {len(pieces.faces[axis])} colors")
    if pieces is not None and tiling.interior.max(initial=-1) >= len(pieces.interiors):
        raise ValueError(f"a cell has interior {tiling.interior.max()}, of {len(pieces.interiors)} interiors")


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
