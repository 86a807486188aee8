"""Surroundings of the interiors of a tile set, for samplers: of one interior, and of all."""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.length import Cell
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.services.arrays import F64, I64

if TYPE_CHECKING:
    from sppm_pipeline.method.sampling.many import Surrounding

MIN_PORES = 4
"""Minimum number of pores of a graded cell: fewer have no three neighbors each."""

MIN_PORES_BETWEEN_FACES = 1
"""Minimum number of pores of the interior of a graded cell with pores on its faces, which are joined to it."""

MANY = 64
"""Interiors or pieces from which a compiled kernel for many of them is used: it takes longer to load than a few pieces
take. The result is the same either way."""


class InteriorBox(NamedTuple):
    """Region in which a sampler places the pores of one interior.

    Attributes
    ----------
    lower, upper : (3,) float64, cell sizes
    periodic : bool
        Whether the box is the whole cell and repeats; then pores near opposite faces are neighbors.
    obstacles : (k, 3) float64
        Pores that are there already: those of this interior and of every face it may meet, on the side it meets it, or
        of neighboring blocks.
    cell : Cell
        Turns the user's lengths into cell sizes.
    spacing : float or None
        Spacing of the pores thrown before, cell sizes.
    face_pores : int
        Pores on the faces of one cell, opposite faces counted once; the mean where colors differ.
    folded : (m, 4) float64
        The pores that are there already, images and opposite faces left out: positions in cell sizes, and in which
        share of the cells of this interior they stand.
    """

    lower: F64
    upper: F64
    periodic: bool
    obstacles: F64
    cell: Cell
    spacing: float | None
    face_pores: int
    folded: F64 = np.zeros((0, 4))


class Meetings:
    """Pores that an interior may meet: on faces with an open palette all, else those of its own; on edges all."""

    def __init__(self, pores: PoreSet, palette: Palette) -> None:
        self._pores = pores
        self._edges = pores.around_edges()
        self._rows = palette.meetings if pores.has_faces else None
        if self._rows is not None:
            self._rows = self._rows[np.argsort(self._rows[:, 0], kind="stable")]
            self._first = np.searchsorted(self._rows[:, 0], np.arange(pores.interiors + 1))
            return
        axis = pores.axis_of_piece()[pores.piece]
        # with any colors on any side each pattern is an obstacle at both ends of its axis
        low, normal = pores.centers[axis >= 0], np.eye(3)[axis[axis >= 0]]
        self._all = np.concatenate([low, low + normal, self._edges])
        if max(pores.colors) == 1:
            # patterns go on in their planes beside the cell; those of several colors keep a margin instead
            shifts = np.array(list(itertools.product((-1, 0, 1), repeat=3)))[:, None]
            everywhere = np.where(normal > 0, shifts >= 0, True).all(-1)
            self._all = (low + shifts)[everywhere]

    def folded(self, interior: int) -> F64:
        """Pores of one cell, each once, with the share of the interior's cells that they stand in, (m, 4).

        Each side of an axis counts half, and all face patterns that an interior may meet there count alike.
        """
        pores = self._pores
        own = pores.of_piece(interior)
        parts = [np.column_stack([own, np.ones(len(own))])]
        if self._rows is None:
            axis = pores.axis_of_piece()[pores.piece]
            share = 1 / np.maximum(pores.colors, 1)[axis[axis >= 0]]
            parts.append(np.column_stack([pores.centers[axis >= 0], share]))
        else:
            rows = self._rows_of(interior)
            met = np.bincount(rows[:, 1], minlength=3)
            for _, axis, _, color in rows:
                pattern = pores.of_piece(pores.face_piece(axis, color))
                parts.append(np.column_stack([pattern, np.full(len(pattern), 1 / met[axis])]))
        return np.concatenate(parts)

    def _rows_of(self, interior: int) -> I64:
        assert self._rows is not None
        return self._rows[self._first[interior] : self._first[interior + 1]]

    def pores_around(self, interior: int) -> F64:
        """Face pores around one interior, in the coordinates of its cell, (k, 3)."""
        if self._rows is None:
            return self._all
        around = [self._edges]
        for _, axis, side, color in self._rows_of(interior):
            around.append(self._pores.of_piece(self._pores.face_piece(axis, color)) + side * np.eye(3)[axis])
        return np.concatenate(around)


class Interiors:
    """All interiors that a sampler fills, of `pores` that are there already.

    `gap` is that from the faces to the box of the interior pores, `spacing` the one that the sampler was asked for, or
    of the pores thrown before, both cell sizes; `alike` says whether all have one number of pores and one spacing.
    """

    def __init__(self, pores: PoreSet, palette: Palette, gap: float, spacing: float | None) -> None:
        self.pores, self.gap, self.spacing = pores, gap, spacing
        self._palette = palette
        self.alike = palette.totals is None and palette.spacings is None
        on_axis = np.bincount(pores.axis_of_piece()[pores.piece] + 1, minlength=4)[1:]
        # mean over the colors of each axis, opposite faces counted once
        self.face_pores = round(sum(n / c for n, c in zip(on_axis, pores.colors, strict=True) if c))

    def __len__(self) -> int:
        return self.pores.interiors

    @cached_property
    def _meetings(self) -> Meetings:
        return Meetings(self.pores, self._palette)

    def box(self, interior: int) -> InteriorBox:
        """Box and surroundings of one of them."""
        pores = self.pores
        return InteriorBox(
            lower=np.full(3, self.gap), upper=np.full(3, 1 - self.gap), periodic=not pores.has_faces,
            obstacles=np.concatenate([pores.of_piece(interior), self._meetings.pores_around(interior)]),
            cell=pores.cell, spacing=self.spacing, face_pores=self.face_pores, folded=self._meetings.folded(interior),
        )  # fmt: skip

    def surrounding(self) -> tuple[Surrounding, F64]:
        """The obstacles of all boxes, if there are faces: those of each, and those of all, (k, 3)."""
        from sppm_pipeline.method.sampling.many import Surrounding

        pores, own = self.pores, np.arange(len(self))
        rows = self._palette.meetings
        if rows is None:
            everywhere, rows = self._meetings.pores_around(0), np.zeros((0, 4), np.int64)
        else:
            everywhere = pores.around_edges()
        shift = np.zeros((len(own) + len(rows), 3), np.int64)
        shift[np.arange(len(own), len(shift)), rows[:, 1]] = rows[:, 2]
        interior = np.concatenate([own, rows[:, 0]])
        piece = np.concatenate([own, pores.face_pieces(rows[:, 1], rows[:, 3])])
        order, first = pores.by_piece
        by_interior = np.argsort(interior, kind="stable")
        bounds = np.searchsorted(interior[by_interior], np.arange(len(own) + 1))
        return Surrounding(pores.centers[order], first, piece[by_interior], shift[by_interior], bounds), everywhere
