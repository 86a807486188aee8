"""The pieces of a tiling (interiors, faces, connectors), their places, and which meet at a lattice site.

A *site* is a place of the lattice of cells: its cell, if there is one, and the faces in its three low planes. Every
face belongs to exactly one site, which is how shared faces are counted once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.kernels.kernels import Kernels, concatenated
from sppm_pipeline.method.tiling.lattice import dilated, face_presence
from sppm_pipeline.services.arrays import I32, I64


@dataclass(frozen=True, eq=False)
class Pieces:
    """Kernel sets from which every cell of a tiling is put together; all lengths in cell sizes.

    A piece is an interior, a face pattern, or the connectors between an interior and a face. All of them lie one after
    the other in a few arrays, as there may be a hundred thousand: interiors, then faces by axis and color, then
    connectors in the order of their codes.

    Attributes
    ----------
    kernels : Kernels
        Of all pieces. Those of an interior, and connectors, are relative to the low corner of the cell; those of a face
        lie in the plane ``coordinate[axis] = 0``, relative to the low corner of the cell on the high side of the plane.
        A tunnel may leave its cell.
    first_pore, first_tunnel : (pieces + 1,) int64
        Piece i has the pores ``first_pore[i] <= index < first_pore[i + 1]``, and likewise tunnels.
    interiors : int
        Number of interiors, K.
    colors : int
        Number of face colors of each axis, c.
    codes : (q,) int64
        Ascending codes (`connector_code`) of the combinations of interior, axis, side and color that have connectors;
        those of side 1 end in the plane ``coordinate[axis] = 1``.
    """

    kernels: Kernels
    first_pore: I64
    first_tunnel: I64
    interiors: int
    colors: int
    codes: I64

    @classmethod
    def of(
        cls,
        interiors: Sequence[Kernels],
        faces: Sequence[Sequence[Kernels]] = ((), (), ()),
        connectors: Mapping[tuple[int, int, int, int], Kernels] | None = None,
    ) -> Pieces:
        """Put separate kernel sets together.

        Parameters
        ----------
        interiors : sequence of K Kernels
        faces : 3 sequences of c Kernels
            ``faces[axis][color]``.
        connectors : mapping of (interior, axis, side, color) to Kernels
            Side 0 is the low face. Absent means none.
        """
        colors = len(faces[0])
        coded = {int(connector_code(*key, colors=colors)): kernels for key, kernels in (connectors or {}).items()}
        codes = sorted(coded)
        parts = [*interiors, *(kernels for axis in faces for kernels in axis), *(coded[code] for code in codes)]
        return cls(
            concatenated(parts),
            _ends(len(part.centers) for part in parts),
            _ends(len(part.starts) for part in parts),
            len(interiors),
            colors,
            np.array(codes, np.int64),
        )

    @property
    def numbers(self) -> PieceNumbers:
        """Which piece has which number."""
        return PieceNumbers(self.interiors, self.colors, self.codes)

    def __len__(self) -> int:
        return len(self.first_pore) - 1

    def __getitem__(self, number: int) -> Kernels:
        """The kernels of one piece."""
        pores = slice(self.first_pore[number], self.first_pore[number + 1])
        tunnels = slice(self.first_tunnel[number], self.first_tunnel[number + 1])
        return self.kernels.taken(pores, tunnels)


def _ends(counts: Iterable[int]) -> I64:
    return np.cumsum([0, *counts], dtype=np.int64)


def connector_code(
    interior: NDArray[np.integer] | int,
    axis: NDArray[np.integer] | int,
    side: NDArray[np.integer] | int,
    color: NDArray[np.integer] | int,
    *,
    colors: int,
) -> I64:
    """One number for an interior, an axis, a side and a color; the numbers of an interior follow each other."""
    row = (np.asarray(interior, np.int64) * 3 + axis) * 2 + side
    code: I64 = row * colors + color
    return code


class PieceNumbers(NamedTuple):
    """Numbers by which the index of a piece is computed; see `Pieces`."""

    interiors: int
    colors: int
    codes: I64

    def __len__(self) -> int:
        return self.interiors + 3 * self.colors + len(self.codes)

    def face(self, axis: int, color: I32) -> I64:
        """Numbers of faces; color -1 gives -1."""
        return np.where(color >= 0, self.interiors + axis * self.colors + color.astype(np.int64), -1)

    def connector(self, interior: I32, axis: int, side: int, color: I32) -> I64:
        """Numbers of connectors; -1 where there is none, and where interior or color is -1."""
        if not len(self.codes):
            return np.full(np.shape(interior), -1, np.int64)
        code = connector_code(interior, axis, side, color, colors=self.colors)
        place = np.minimum(np.searchsorted(self.codes, code), len(self.codes) - 1)
        there = (self.codes[place] == code) & (interior >= 0) & (color >= 0)
        return np.where(there, self.interiors + 3 * self.colors + place, -1)


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
    halo : int
        So many outermost cells on each side lie around the box: their kernels reach into it. Cell (0, 0, 0) is entry
        (halo, halo, halo) of the arrays.
    """

    interior: I32
    faces: tuple[I32, I32, I32]
    periodic: bool
    halo: int = 0

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells of the box along x, y, z."""
        nx, ny, nz = self.interior.shape
        return nx - 2 * self.halo, ny - 2 * self.halo, nz - 2 * self.halo

    @property
    def box(self) -> I32:
        """Interiors of the cells of the box, without the halo."""
        inner = slice(self.halo, -self.halo or None)
        return self.interior[inner, inner, inner]

    def surrounded(self) -> TilingArrays:
        """The box with those cells alone that have all their neighbors: what is laid around a part is left out."""
        if not self.halo:
            return self
        inner = slice(self.halo, -self.halo)
        interior = np.where(dilated(self.interior < 0)[inner, inner, inner], np.int32(-1), self.box)
        x, y, z = (
            np.where(there, faces[tuple(slice(self.halo, self.halo + n) for n in there.shape)], np.int32(-1))
            for there, faces in zip(face_presence(interior >= 0), self.faces, strict=True)
        )
        return TilingArrays(interior, (x, y, z), self.periodic)


def lone_periodic_cell(interior: int = 0, colors: tuple[int, int, int] = (0, 0, 0)) -> TilingArrays:
    """One cell whose opposite faces are the same: a periodic tiling of 1 x 1 x 1 cells."""
    x, y, z = (np.full(np.where(np.arange(3) == axis, 2, 1), color, np.int32) for axis, color in enumerate(colors))
    return TilingArrays(np.full((1, 1, 1), interior, np.int32), (x, y, z), True)


def check_tiling(tiling: TilingArrays, pieces: Pieces | None = None) -> None:
    """Check shapes and types, and with `pieces` that every interior and color exists.

    Raises ValueError if a shape or type is wrong, the first and last plane of faces of a periodic tiling differ, or a
    number names no piece.
    """
    shape = tiling.interior.shape
    if len(shape) != 3 or len(tiling.faces) != 3:
        raise ValueError(f"a tiling has cells along 3 axes and faces of 3 axes, got {shape} and {len(tiling.faces)}")
    for what, numbers in (("interiors", tiling.interior), *((f"faces of axis {a}", tiling.faces[a]) for a in range(3))):
        if numbers.dtype != np.int32:
            raise ValueError(f"the {what} are {numbers.dtype}, expected int32")
        if numbers.min(initial=-1) < -1:
            raise ValueError(f"the {what} are numbered from 0, and -1 where there is none, got {numbers.min()}")
    if tiling.halo < 0 or min(tiling.shape) < 1 or (tiling.periodic and tiling.halo):
        raise ValueError(f"a box of {shape} cells, periodic: {tiling.periodic}, has no halo of {tiling.halo}")
    for axis, faces in enumerate(tiling.faces):
        expected = tuple(size + (a == axis) for a, size in enumerate(shape))
        if faces.shape != expected:
            raise ValueError(f"faces of axis {axis} have the shape {faces.shape}, expected {expected}")
        if tiling.periodic and (np.take(faces, 0, axis) != np.take(faces, -1, axis)).any():
            raise ValueError(f"the tiling is periodic, but the first and last faces of axis {axis} differ")
        if pieces is not None and faces.max(initial=-1) >= pieces.colors:
            raise ValueError(f"a face of axis {axis} has color {faces.max()}, of {pieces.colors} colors")
    if pieces is not None and tiling.interior.max(initial=-1) >= pieces.interiors:
        raise ValueError(f"a cell has interior {tiling.interior.max()}, of {pieces.interiors} interiors")


#: An interior, three faces, six connectors.
PIECES_A_SITE = 10


class Sites(NamedTuple):
    """A box of lattice sites, first <= site < stop, in index order z, y, x."""

    first: I64  # (3,) x, y, z
    stop: I64  # (3,)
    interior: I32  # (sz, sy, sx) interior of the cell, -1 = no cell
    low: I32  # (3, sz, sy, sx) colors of the low face of each axis, -1 = none
    high: I32  # those of the high face; -1 where there is no cell


def sites_between(tiling: TilingArrays, first: I64, stop: I64) -> Sites:
    """The sites first <= site < stop, clipped to where the tiling has any; only these are looked at."""
    shape, halo = np.array(tiling.interior.shape), tiling.halo
    if not tiling.periodic:
        # The faces in the last lattice planes belong to sites without a cell.
        first, stop = np.maximum(first, -halo), np.minimum(stop, shape - halo + 1)
    stop = np.maximum(first, stop)
    index = [np.arange(first[a], stop[a]) + halo for a in range(3)]
    inside = [np.ones(len(i), dtype=bool) if tiling.periodic else i < shape[a] for a, i in enumerate(index)]
    wrapped = [i % shape[a] if tiling.periodic else np.minimum(i, shape[a] - 1) for a, i in enumerate(index)]
    along = _across(inside)
    cell = along[0] & along[1] & along[2]
    low, high = [], []
    for axis, faces in enumerate(tiling.faces):
        across = inside.copy()
        across[axis] = np.ones_like(inside[axis])
        plane = wrapped.copy()
        plane[axis] = index[axis] % shape[axis] if tiling.periodic else index[axis]
        x, y, z = _across(across)
        low.append(np.where(x & y & z, faces[_across(plane)], -1))
        plane[axis] = wrapped[axis] + 1
        high.append(np.where(cell, faces[_across(plane)], -1))
    interior = np.where(cell, tiling.interior[_across(wrapped)], -1)
    high = [np.where(interior >= 0, faces, -1) for faces in high]
    order = (0, 3, 2, 1)
    return Sites(
        first,
        stop,
        np.ascontiguousarray(interior.transpose(2, 1, 0), dtype=np.int32),
        np.ascontiguousarray(np.array(low).transpose(order), dtype=np.int32),
        np.ascontiguousarray(np.array(high).transpose(order), dtype=np.int32),
    )


def _across(index: list[NDArray[Any]]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Arrays along x, y and z that meet in a box; `np.ix_` is the same with checks that take longer than the box."""
    return index[0][:, None, None], index[1][:, None], index[2]


def site_pieces(numbers: PieceNumbers, sites: Sites) -> I32:
    """Numbers of the pieces at each site, (sz, sy, sx, 10), -1 = none.

    Interior, low faces of x, y, z, then the connectors by axis and side.
    """
    found = np.empty((*sites.interior.shape, PIECES_A_SITE), dtype=np.int32)
    found[..., 0] = sites.interior
    for axis in range(3):
        low, high = sites.low[axis], sites.high[axis]
        found[..., 1 + axis] = numbers.face(axis, low)
        found[..., 4 + 2 * axis] = numbers.connector(sites.interior, axis, 0, low)
        found[..., 5 + 2 * axis] = numbers.connector(sites.interior, axis, 1, high)
    return found
