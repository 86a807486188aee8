"""Base class of samplers: one method throws the pores of one interior."""

from __future__ import annotations

import itertools
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import Cell, Length
from sppm_pipeline.data.palette import Blocks, Palette
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.data.size import CellDesign, Size
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import options
from sppm_pipeline.families.scattered import block_by_block
from sppm_pipeline.stage import Context, Stage, option

FEWEST = 4
"""Pores of the interior of a graded cell at the least: fewer have no three neighbors each."""


class InteriorBox(NamedTuple):
    """Where a sampler puts the pores of one interior.

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

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    periodic: bool
    obstacles: NDArray[np.float64]
    cell: Cell
    spacing: float | None
    face_pores: int
    folded: NDArray[np.float64] = np.zeros((0, 4))


@dataclass(frozen=True, kw_only=True)
class Sampler(Stage):
    """Base of samplers that fill the interior of a cell: implement `throw`, or replace `run`.

    `run` calls `throw` once for each interior requested, each with its own generator. Where pores lie on the faces, the
    interior is the box ``[gap, 1 - gap]^3``, otherwise the whole periodic cell. For scattered cells it is a block of a
    lattice without faces, and the pores of neighboring blocks thrown before are obstacles.

    Attributes
    ----------
    needs_whole_cell : str
        Why cells can't be scattered with this sampler; empty if they can.
    """

    needs_whole_cell: ClassVar[str] = ""

    edge: Length | None = options.edge(
        None,
        note="the lengths of this recipe are given in a cell of this size, 1 if omitted",
        unit=None,
        above=None,
        minimum=1e-6,
        maximum=1e6,
    )
    gap: Length | None = option(
        None,
        help="distance d from the faces to the box of the interior pores; if omitted the spacing, or half of it where "
        "distances to face pores are checked one by one",
        unit="cell size",
        minimum=0,
        maximum=1e6,
    )

    @abstractmethod
    def throw(self, rng: np.random.Generator, box: InteriorBox) -> NDArray[np.float64]:
        """Pores of one interior, (n, 3) float64 in cell sizes."""

    def requested_spacing(self, cell: Cell) -> float | None:
        """The spacing this sampler was asked for, cell sizes; None if it takes that of the pores before, or none."""
        return None

    def kept_spacing(self, cell: Cell, before: PoreSet) -> float | None:
        """The distance that any two pores keep in the end, cell sizes, if that is known."""
        return None

    def gap_from_faces(self, cell: Cell, pores: PoreSet) -> float:
        """Distance from the faces to the box of the interior pores, cell sizes."""
        if self.gap is not None:
            return cell.fraction(self.gap)
        return (self.requested_spacing(cell) or pores.spacing or 0.0) if pores.has_faces else 0.0

    def expected_count(self, face_pores: float) -> float:
        """Pores of one interior as the options state; `LookupError` if they do not."""
        for name in ("count", "total"):
            value = getattr(self, name, None)
            if value is not None:
                return max(0.0, float(value) - (face_pores if name == "total" else 0.0))
        raise LookupError("the number of pores is unknown")

    def estimate(self, palette: Palette, pores: Size | None) -> Size:
        cell = pores.cell if pores else design_of(self.edge)
        count = self.expected_count(cell.face_pores)
        cell = replace(cell, interiors=palette.interiors, interior_pores=cell.interior_pores + count)
        return Size(pores=count * palette.interiors, design=cell)

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Throw the pores of all interiors."""
        cell, base = start_of(self.edge, pores, context.palette.interiors)
        if context.palette.blocks is not None:
            if self.needs_whole_cell:
                raise ConfigError(
                    f"{self.name} can't scatter pores: {self.needs_whole_cell}", hint="use `sample.dart_throwing`"
                )
            if self.gap is not None:
                context.warn("option 'gap': scattered cells have no faces to keep a gap from")
            return self.scatter(context, base, context.palette.blocks)
        spacing = self.requested_spacing(cell) or base.spacing
        gap = self.gap_from_faces(cell, base)
        if gap >= 0.5:
            raise DesignError(
                f"the gap of {gap:g} cell sizes leaves no interior; it must be below 0.5",
                hint="give a smaller `gap` or a smaller spacing",
            )
        meetings, palette = Meetings(base, context.palette), context.palette
        on_axis = np.bincount(base.axis_of_piece()[base.piece] + 1, minlength=4)[1:]
        face_pores = round(sum(n / c for n, c in zip(on_axis, base.colors, strict=True) if c))
        centers, piece = [], []
        for t in range(base.interiors):
            own = base.of_piece(t)
            box = InteriorBox(
                lower=np.full(3, gap),
                upper=np.full(3, 1 - gap),
                periodic=not base.has_faces,
                obstacles=np.concatenate([own, meetings.pores_around(t)]),
                cell=cell,
                spacing=spacing,
                face_pores=face_pores,
                folded=meetings.folded(t),
            )
            stage, box = self._graded(palette, t, box, len(own))
            thrown = stage.thrown(context, t, box)
            centers.append(thrown)
            piece.append(np.full(len(thrown), t, np.int32))
            if base.interiors > 1:
                context.progress(t + 1, base.interiors, "interiors")
        kept = self.kept_spacing(cell, base)
        if kept is not None and palette.spacings is not None:
            kept *= min(1.0, float(palette.spacings.min()))
        return base.extended(np.concatenate(centers), np.concatenate(piece), spacing=kept)

    def with_pores(self, count: int, face_pores: int = 0) -> Sampler:
        """The same stage for an interior of so many pores, by its options `total` or `count`.

        Raises
        ------
        ConfigError
            If it has neither.
        """
        if getattr(self, "total", None) is not None:
            return replace(self, total=count + face_pores)  # type: ignore[call-arg]
        if getattr(self, "count", None) is not None:
            return replace(self, count=count)  # type: ignore[call-arg]
        raise ConfigError(f"{self.name} can't be told how many pores a graded cell has", hint="give it a `total`")

    def _graded(self, palette: Palette, interior: int, box: InteriorBox, before: int) -> tuple[Sampler, InteriorBox]:
        """The stage and the box with the number and the spacing of pores that the palette wants of an interior."""
        if palette.spacings is not None and box.spacing is not None:
            box = box._replace(spacing=box.spacing * float(palette.spacings[interior]))
        if palette.totals is None:
            return self, box
        face_pores = round(float(box.folded[before:, 3].sum()))
        count = max(int(palette.totals[interior]) - face_pores, FEWEST)
        return self.with_pores(count, face_pores), box._replace(face_pores=face_pores)

    def scatter(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        """Throw the pores of all blocks of a lattice without faces, block by block; for samplers with a faster way."""
        return block_by_block(context, self, base, blocks)

    def thrown(self, context: Context, interior: int, box: InteriorBox) -> NDArray[np.float64]:
        """What `throw` returns for an interior, checked."""
        points = np.asarray(self.throw(context.rng(interior), box), np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise ValueError(f"{self.name}.throw must return finite points of shape (n, 3), got {points.shape}")
        return points


def design_of(edge: Length | None) -> CellDesign:
    """The design that a first sampler starts from."""
    return CellDesign(edge=edge.mm() if edge else 1.0, edge_mm=edge.mm() if edge and edge.unit else None)


def start_of(edge: Length | None, pores: PoreSet | None, interiors: int) -> tuple[Cell, PoreSet]:
    """The cell and the pores a sampler starts from.

    Raises
    ------
    DesignError
        If `edge` contradicts the cell of the pores thrown before.
    """
    cell = Cell(edge.mm(), True) if edge and edge.unit else Cell(edge.value if edge else 1.0)
    if pores is None:
        return cell, PoreSet(cell=cell, centers=np.zeros((0, 3)), piece=np.zeros(0, np.int32), interiors=interiors)
    if edge is not None and cell != pores.cell:
        raise DesignError(
            f"`edge` is {edge}, but the pores thrown before live in a cell with edge {pores.cell.edge:g}",
            hint="give `edge` once, on the first sampling stage of the recipe",
        )
    return pores.cell, pores


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
        low, normal = pores.centers[axis >= 0], np.eye(3)[axis[axis >= 0]]
        self._all = np.concatenate([low, low + normal, self._edges])
        if max(pores.colors) == 1:
            # patterns go on in their planes beside the cell; those of several colors keep a margin instead
            shifts = np.array(list(itertools.product((-1, 0, 1), repeat=3)))[:, None]
            everywhere = np.where(normal > 0, shifts >= 0, True).all(-1)
            self._all = (low + shifts)[everywhere]

    def folded(self, interior: int) -> NDArray[np.float64]:
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

    def _rows_of(self, interior: int) -> NDArray[np.int64]:
        assert self._rows is not None
        return self._rows[self._first[interior] : self._first[interior + 1]]

    def pores_around(self, interior: int) -> NDArray[np.float64]:
        """Face pores around one interior, in the coordinates of its cell, (k, 3)."""
        if self._rows is None:
            return self._all
        around = [self._edges]
        for _, axis, side, color in self._rows_of(interior):
            around.append(self._pores.of_piece(self._pores.face_piece(axis, color)) + side * np.eye(3)[axis])
        return np.concatenate(around)
