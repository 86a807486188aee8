"""``sample.hyperuniform``: disordered pores without density fluctuations at long waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from sppm_pipeline import Cell, ConfigError, Context, Length, PoreSet, Sampler, option, options
from sppm_pipeline.method.families.interiors import InteriorBox, Meetings
from sppm_pipeline.method.families.scattered import FilledBlocks, with_evened
from sppm_pipeline.method.stages.sample_dart_throwing import HALF_PACKED
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64

if TYPE_CHECKING:
    from sppm_pipeline.method.sampling.structure_factor import Waves

PERIODIC, BETWEEN_FACES = 0.4, 0.2
"""Default stealth of a cell without face pores and with them; with more, few face patterns leave a solution."""


@dataclass(frozen=True, kw_only=True)
class Hyperuniform(Sampler):
    """Stealthy hyperuniform pores: independent pores, moved until the structure factor vanishes for all long waves.

    Such pores are as evenly spread as those of a lattice over long distances, and as disordered as thrown ones over
    short distances (Torquato 2018, "Hyperuniform states of matter"). Pores on the faces stay where they are and count:
    the pores of the whole cell, periodically repeated, have no structure factor. Where an interior may meet several
    face patterns, that holds for the mean of these patterns.

    Scattered pores are evened out all at once, wherever a block ends: by descent on a pair potential whose transform
    covers the same waves. Their structure factor gets small there instead of zero, and blocks exchange pores. Where a
    map changes the density, blocks are silenced one by one among the pores of their neighbors.
    """

    name: ClassVar[str] = "sample.hyperuniform"
    version: ClassVar[int] = 2

    count: int | None = options.count(None, note="in one interior", minimum=2, maximum=10_000)
    total: int | None = options.total(None, note="those on the faces are taken off", maximum=10_000)
    stealth: float | None = option(
        None,
        help="number of silenced waves as a share of the coordinates of the pores, chi in the literature; above 0.5 "
        f"pores would crystallize; {PERIODIC:g} if omitted, {BETWEEN_FACES:g} where pores lie on the faces",
        minimum=0.05,
        maximum=0.5,
    )
    spacing: Length | None = options.spacing(None, note="that of the face pores if omitted, else that of half packing")

    def check_options(self) -> None:
        if (self.count is None) == (self.total is None):
            raise ConfigError("give the number of pores: `count` of one interior, or `total` of the cell")

    def requested_spacing(self, cell: Cell) -> float | None:
        return None if self.spacing is None else cell.fraction(self.spacing)

    def gap_from_faces(self, cell: Cell, pores: PoreSet) -> float:
        """Half the spacing unless given: what two interiors on either side of a face need."""
        whole = super().gap_from_faces(cell, pores)
        return whole / 2 if self.gap is None else whole

    def kept_spacing(self, cell: Cell, before: PoreSet) -> float | None:
        own = self.requested_spacing(cell) or before.spacing
        if not len(before.centers):
            return own or self._half_packed(0)
        return min(own, before.spacing) if own and before.spacing else None

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Move the pores of all interiors; report the waves that were silenced and the smallest distance."""
        from sppm_pipeline.method.sampling.capacity import min_spacing
        from sppm_pipeline.method.sampling.structure_factor import structure_factor

        thrown = super().run(context, pores)
        if thrown.blocks is not None and context.palette.blocks is not None and _together(context.palette.blocks):
            return thrown  # `scatter` has reported
        meetings = Meetings(thrown, context.palette)
        loudest = 0.0
        for t in range(thrown.interiors):
            placed = len(thrown.of_piece(t)) - (len(pores.of_piece(t)) if pores else 0)
            waves, cell = self._waves(placed, thrown.has_faces), meetings.folded(t)
            loudest = max(loudest, float(structure_factor(cell[:, :3], waves, cell[:, 3]).max()))
        repeats = (not thrown.has_faces and thrown.blocks is None,) * 3
        context.report(
            waves=2 * waves.number, shortest_wave=1 / waves.radius, largest_structure_factor=loudest,
            smallest_distance=min(min_spacing(thrown.of_piece(t), repeats) for t in range(thrown.interiors)),
        )  # fmt: skip
        return thrown

    def scatter(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        # equal pairs at equal distances: where the density varies, they would even that out, too
        if not _together(blocks):
            return super().scatter(context, base, blocks)
        count = self.count if self.total is None else max(self.total - len(base.centers) / base.interiors, 0)
        assert count is not None
        spacing = self.requested_spacing(base.cell) or base.spacing or self._half_packed(0)
        pores, factor = with_evened(context, base, blocks, count, spacing, self.stealth or PERIODIC)
        if blocks.periodic:
            context.report(mean_structure_factor=factor)
        return pores

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> F64:
        from sppm_pipeline.method.sampling.stealthy import Surroundings, throw_stealthy

        fixed, weight = box.folded[:, :3], box.folded[:, 3]
        before = box.face_pores or len(fixed)
        count = max(self.total - before, 0) if self.total is not None else self.count
        assert count is not None
        around = Surroundings(box.lower, box.upper, box.periodic, fixed, weight, box.obstacles)
        spacing = box.spacing or self._half_packed(before)
        return throw_stealthy(rng, count, self._waves(count, box.face_pores > 0), spacing, around)

    def _half_packed(self, before: int) -> float:
        """The spacing at which the pores of a cell are half as many as fit."""
        from sppm_pipeline.method.sampling.capacity import largest_spacing

        pores = self.total or (self.count or 0) + before
        return largest_spacing(max(round(pores / HALF_PACKED), 1), (1.0, 1.0, 1.0), periodic=True)

    def _waves(self, count: int, has_faces: bool) -> Waves:
        from sppm_pipeline.method.sampling.stealthy import stealthy_waves

        return stealthy_waves(count, self.stealth or (BETWEEN_FACES if has_faces else PERIODIC))


def _together(blocks: Blocks) -> bool:
    """True if the pores of all blocks are evened out together: those whose density a map changes are not."""
    return blocks.density is None and not isinstance(blocks, FilledBlocks)
