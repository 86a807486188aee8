"""``sample.dart_throwing``: blue noise in the interior of the cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Cell, ConfigError, Context, Length, PoreSet, Sampler, option, options
from sppm_pipeline.method.families.interiors import MANY, InteriorBox, Interiors
from sppm_pipeline.method.families.scattered import with_darts
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64, I64

HALF_PACKED = 0.5
"""Fraction of the packing limit at which a number of pores is thrown if nothing says how close they may come: blue
noise without a trace of crystal order, and every dart finds its place within some tries."""


@dataclass(frozen=True, kw_only=True)
class DartThrowing(Sampler):
    """Throw pores one after the other, discarding those closer than the spacing (paper, "Stochasticity of SPPM").

    Above three quarters of the packing limit darts are thrown only where there still is room (active voxels), which
    draws from the same distribution without waiting for a lucky dart.
    """

    name: ClassVar[str] = "sample.dart_throwing"

    count: int | None = options.count(None, note="in one interior")
    total: int | None = options.total(None, note="those on the faces are taken off")
    spacing: Length | None = options.spacing(None, note="that of the face pores if omitted, else that of half packing")
    share: float | None = options.share(None, note="1 until nothing fits")
    clear_faces: bool = option(True, help="keep the spacing between interior pores and face pores, too")

    def check_options(self) -> None:
        if self.count is not None and self.total is not None:
            raise ConfigError("`count` and `total` exclude each other")
        if self.count is None and self.total is None and self.share is None:
            raise ConfigError("give the number of pores (`count` or `total`), or a `share` to fill up to")
        if self.spacing is not None and self.share is not None and (self.count, self.total) != (None, None):
            raise ConfigError("the number of pores, `spacing` and `share` are one too many: leave one out")

    def requested_spacing(self, cell: Cell) -> float | None:
        return None if self.spacing is None else cell.fraction(self.spacing)

    def gap_from_faces(self, cell: Cell, pores: PoreSet) -> float:
        """Half the spacing unless given: distances to face pores are checked one by one, and from the faces half is
        what two interiors on either side need. Without that check the whole spacing, as in the paper.
        """
        whole = super().gap_from_faces(cell, pores)
        return whole / 2 if self.gap is None and self.clear_faces else whole

    def kept_spacing(self, cell: Cell, before: PoreSet) -> float | None:
        known = [spacing for spacing in (self.requested_spacing(cell), before.spacing) if spacing is not None]
        if not known or (len(before.centers) and before.spacing is None):
            return None
        apart = self.clear_faces or (before.has_faces and self.gap_from_faces(cell, before) >= min(known))
        return min(known) if apart or not len(before.centers) else None

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Throw the pores of all interiors."""
        from sppm_pipeline.method.sampling.capacity import box_capacity

        thrown = super().run(context, pores)
        spacing = self.requested_spacing(thrown.cell) or (pores.spacing if pores else None)
        if spacing:
            inside = float((thrown.piece < thrown.interiors).sum()) / thrown.interiors
            gap = self.gap_from_faces(thrown.cell, pores or thrown)
            capacity = box_capacity((1 - 2 * gap,) * 3, spacing, periodic=not thrown.has_faces)
            context.report(interior_packing_share=inside / capacity)
        return thrown

    def scatter(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        from sppm_pipeline.method.sampling.capacity import box_capacity

        spacing = self.requested_spacing(base.cell) or base.spacing
        count = self.count if self.total is None else max(self.total - len(base.centers) / base.interiors, 0.0)
        if count is None:
            if spacing is None:
                raise ConfigError("the spacing is missing", hint="give `spacing`, or `total` with `share`")
            assert self.share is not None
            count = self.share * box_capacity(1.0, spacing, True)
        if spacing is None:
            from sppm_pipeline.method.sampling.blocks import spacing_at_share

            spacing = spacing_at_share(count, self.share or HALF_PACKED)
        return with_darts(context, base, blocks, count, spacing, obstacles=self.clear_faces)

    def throw_all(self, context: Context, interiors: Interiors) -> tuple[F64, I64]:
        replaced = type(self).throw is not DartThrowing.throw
        if replaced or not (interiors.alike and interiors.pores.has_faces and len(interiors) >= MANY):
            return super().throw_all(context, interiors)
        from sppm_pipeline.method.sampling.cell_list import new_stream
        from sppm_pipeline.method.sampling.many import nothing_around, throw_many

        box = interiors.box(0)
        count, spacing, share = self._packing(box)
        around, obstacles = interiors.surrounding() if self.clear_faces else (nothing_around(len(interiors)), None)
        streams = np.concatenate([new_stream(context.rng(t)) for t in range(len(interiors))])
        centers, counts = [], np.zeros(len(interiors), np.int64)
        done = 0
        for thrown, found in throw_many(
            streams, count, spacing, box.lower, box.upper,
            around=around, obstacles=obstacles, share=share, threads=context.threads,
        ):  # fmt: skip
            for left in np.flatnonzero(found < 0).tolist():
                # raises the error that names what fits
                self.thrown(context, done + left, interiors.box(done + left))
            counts[done : done + len(found)] = found
            centers.append(thrown)
            done += len(found)
            context.progress(done, len(interiors), "interiors")
        return np.concatenate(centers), counts

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> F64:
        from sppm_pipeline.method.sampling.darts import throw

        count, spacing, share = self._packing(box)
        return throw(
            rng, count, spacing, box.lower, box.upper, periodic=(box.periodic,) * 3,
            obstacles=box.obstacles if self.clear_faces else None, obstacle_images=box.periodic, share=share,
        )  # fmt: skip

    def _packing(self, box: InteriorBox) -> tuple[int | None, float, float | None]:
        """Number of pores of an interior, their spacing in cell sizes, and the share of the packing limit."""
        from sppm_pipeline.method.sampling.capacity import largest_spacing

        count = self.count
        if self.total is not None:
            count = max(self.total - box.face_pores, 0)
        spacing = box.spacing
        if spacing is None:
            if count is None:
                raise ConfigError("the spacing is missing", hint="give `spacing`, or `total` with `share`")
            # at share s of the packing limit a count n needs the spacing at which n / s pores are the limit
            pores = max(round(count / (self.share or HALF_PACKED)), 1)
            sides = tuple(float(v) for v in box.upper - box.lower)
            spacing = min(largest_spacing(pores, sides, periodic=box.periodic), 1.0)
        return count, spacing, self.share if count is None else None
