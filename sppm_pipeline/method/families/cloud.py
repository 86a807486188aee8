"""Pores that connectors join: the pores of one piece, or of a whole lattice of blocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.services.arrays import F64, I64


class Piece(NamedTuple):
    """The pores of one interior or one face pattern, to be joined.

    Attributes
    ----------
    points : (n, 3) float64, cell sizes
    periodic : bool
        Whether tunnels may lead to images in neighboring cells (a cell without face pores).
    region : str
        "face" or "interior".
    cell : Cell
        Turns the user's lengths into cell sizes.
    graded : bool
        Whether the number of pores between faces follows a map, and may be too small for the bounds of a degree.
    """

    points: F64
    periodic: bool
    region: str
    cell: Cell
    graded: bool = False


@dataclass(frozen=True)
class CellCube(Cell):
    """A cube of `cells`^3 cells taken for one, as `Piece.periodic` asks: lengths become fractions of the whole cube."""

    cells: int = 1

    def fraction(self, length: Length) -> float:
        # the unit is the edge of the whole cube
        return super().fraction(length) / self.cells


class Cloud(NamedTuple):
    """The pores of a lattice of blocks without faces, to be joined as one graph.

    Attributes
    ----------
    points : (n, 3) float64, cell sizes
        Block (x, y, z) of the lattice fills [x, x + 1] x [y, y + 1] x [z, z + 1]; pores are sorted by block.
    first : (blocks + 1,) int64
        Where the pores of each block begin; blocks in C order of (x, y, z), as in `TilingArrays`. A block may be empty.
    lattice : 3 ints
        Number of blocks along x, y, z.
    periodic : 3 bools
        Axes along which the lattice repeats, with `lattice` as its period.
    cell : Cell
        Turns the user's lengths into cell sizes.
    metric : (n, 6) float64 or None
        Metrics of the pores, see `services.metric`: the distance of two is measured in the mean of theirs. Only
        connectors that follow them are given any.
    """

    points: F64
    first: I64
    lattice: tuple[int, int, int]
    periodic: tuple[bool, bool, bool]
    cell: Cell
    metric: F64 | None = None

    @property
    def period(self) -> F64:
        """Whole cells after which each axis repeats, (3,) float64; 0 for never."""
        return np.where(self.periodic, self.lattice, 0).astype(np.float64)

    @property
    def spacing(self) -> float:
        """Cube root of the mean room of a pore, over the blocks that have any."""
        return float((np.count_nonzero(np.diff(self.first)) / max(len(self.points), 1)) ** (1 / 3))
