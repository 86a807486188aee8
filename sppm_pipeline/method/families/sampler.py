"""Base class of samplers: one method throws the pores of one interior."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families import options
from sppm_pipeline.method.families.interiors import MIN_PORES, MIN_PORES_BETWEEN_FACES, InteriorBox, Interiors
from sppm_pipeline.method.families.scattered import block_by_block
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.nouns.length import Cell, Length
from sppm_pipeline.nouns.palette import Blocks, Palette
from sppm_pipeline.nouns.size import CellDesign, Size
from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.stage import Context, Stage, option


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

    is_random: ClassVar[bool] = True
    needs_whole_cell: ClassVar[str] = ""

    edge: Length | None = options.edge(
        None, note="a number without a unit only says in what unit of length `omega` and `mu` are given, 1 if omitted",
        unit=None, above=None, minimum=1e-6, maximum=1e6,
    )  # fmt: skip
    gap: Length | None = option(
        None,
        help="distance d from the faces to the box of the interior pores; if omitted the spacing, or half of it where "
        "distances to face pores are checked one by one", unit="cell size", minimum=0, maximum=1e6,
    )  # fmt: skip

    @abstractmethod
    def throw(self, rng: np.random.Generator, box: InteriorBox) -> F64:
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
        # both gaps together would be the whole cell
        if gap >= 0.5:
            raise DesignError(
                f"the gap of {gap:g} cell sizes leaves no interior; it must be below 0.5",
                hint="give a smaller `gap` or a smaller spacing",
            )
        interiors = Interiors(base, context.palette, gap, spacing)
        centers, counts = self.throw_all(context, interiors)
        piece = np.repeat(np.arange(base.interiors, dtype=np.int32), counts)
        kept = self.kept_spacing(cell, base)
        if kept is not None and context.palette.spacings is not None:
            # what holds for all interiors is the smallest of their spacings
            kept *= min(1.0, float(context.palette.spacings.min()))
        return base.extended(centers, piece, spacing=kept)

    def throw_all(self, context: Context, interiors: Interiors) -> tuple[F64, I64]:
        """Throw the pores of all interiors by `throw`: centers (n, 3), interior after interior, and how many are in
        each (interiors,); for samplers with a faster way for many of them.
        """
        thrown = []
        for t in range(len(interiors)):
            stage, box = self._graded(context.palette, t, interiors.box(t), len(interiors.pores.indices(t)))
            thrown.append(stage.thrown(context, t, box))
            if len(interiors) > 1:
                context.progress(t + 1, len(interiors), "interiors")
        return np.concatenate(thrown), np.array([len(own) for own in thrown])

    def with_pores(self, count: int, face_pores: int = 0) -> Sampler:
        """The same stage for an interior of so many pores, by `total` or `count`; `ConfigError` if it has neither."""
        if getattr(self, "total", None) is not None:
            # `total` counts the pores on the faces, `count` does not
            return replace(self, total=count + face_pores)  # type: ignore[call-arg]
        if getattr(self, "count", None) is not None:
            return replace(self, count=count)  # type: ignore[call-arg]
        raise ConfigError(
            f"{self.name} has no option for the number of pores of a graded cell", hint="give it a `total`"
        )

    def _graded(self, palette: Palette, interior: int, box: InteriorBox, before: int) -> tuple[Sampler, InteriorBox]:
        """The stage and the box with the number and the spacing of pores that the palette wants of an interior."""
        if palette.spacings is not None and box.spacing is not None:
            box = box._replace(spacing=box.spacing * float(palette.spacings[interior]))
        if palette.totals is None:
            return self, box
        face_pores = round(float(box.folded[before:, 3].sum()))
        count = max(int(palette.totals[interior]) - face_pores, MIN_PORES_BETWEEN_FACES if face_pores else MIN_PORES)
        return self.with_pores(count, face_pores), box._replace(face_pores=face_pores)

    def scatter(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        """Throw the pores of all blocks of a lattice without faces, block by block; for samplers with a faster way."""
        return block_by_block(context, self, base, blocks)

    def thrown(self, context: Context, interior: int, box: InteriorBox) -> F64:
        """Checked result of `throw` for an interior."""
        made: Any = self.throw(context.rng(*context.palette.key(interior)), box)
        if made is None:
            raise ValueError(f"{self.name}.throw must return points of shape (n, 3), got nothing")
        points = np.asarray(made, np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"{self.name}.throw must return points of shape (n, 3), got {points.shape}")
        if not np.isfinite(points).all():
            raise ValueError(f"{self.name}.throw must return finite points, got {points[~np.isfinite(points)][0]}")
        return points


def design_of(edge: Length | None) -> CellDesign:
    """The design that a first sampler starts from."""
    return CellDesign(edge=edge.mm() if edge else 1.0, edge_mm=edge.mm() if edge and edge.unit else None)


def start_of(edge: Length | None, pores: PoreSet | None, interiors: int) -> tuple[Cell, PoreSet]:
    """The cell and the pores a sampler starts from.

    Raises DesignError if `edge` contradicts the cell of the pores thrown before.
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
