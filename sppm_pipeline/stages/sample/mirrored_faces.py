"""``sample.mirrored_faces``: equal pores on opposite faces, so that the cell is periodic."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.palette import Blocks, Palette
from sppm_pipeline.data.pores import PoreSet
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import design_of, options, start_of
from sppm_pipeline.families.scattered import with_darts
from sppm_pipeline.stage import Context, Stage, option

MAX_TOGETHER = 16
"""Colors thrown against each other; more patterns keep a margin that makes them independent."""


@dataclass(frozen=True, kw_only=True)
class MirroredFaces(Stage):
    """Throw pores on the faces of the cell; opposite faces carry the same pattern (paper, "Boundary Periodicity").

    Each pattern keeps the spacing to itself, repeated in its plane, and to the patterns of the perpendicular faces of
    every color. With several colors pores also keep a margin from the border of the face, so that four cells of any
    colors may meet at an edge.
    """

    name: ClassVar[str] = "sample.mirrored_faces"

    count: int | None = options.count(None, note="on the faces of one cell, three faces counted once each")
    total: int | None = options.total(None, note="the faces get their share at equal packing")
    spacing: Length | None = options.spacing(None)
    share: float | None = options.share(None)
    margin: Length | None = option(
        None,
        help="distance of face pores from the border of the face; with several colors at least half the spacing",
        unit="cell size",
        minimum=0,
        maximum=1e6,
    )
    edge: Length | None = options.edge(
        None,
        note="the lengths of this recipe are given in a cell of this size, 1 if omitted",
        unit=None,
        above=None,
        minimum=1e-6,
        maximum=1e6,
    )

    def check_options(self) -> None:
        if self.count is not None and self.total is not None:
            raise ConfigError("`count` and `total` exclude each other")
        given = sum(v is not None for v in (self.spacing, self.share, self.count if self.total is None else self.total))
        if given != 2:
            raise ConfigError(
                "give two of: the number of pores (`count` or `total`), `spacing`, `share`",
                hint="for example `count: 18` and `spacing: 0.16`, or `total: 110` and `share: 0.5`",
            )

    def estimate(self, palette: Palette, pores: Size | None) -> Size:
        colors = palette.colors
        cell = pores.cell if pores else design_of(self.edge)
        if self.total is None and self.count is None:
            from sppm_pipeline.numerics.sampling.faces import split_between_faces_and_interior

            spacing = None if self.spacing is None else self.spacing.value / cell.edge
            on_faces, _ = split_between_faces_and_interior(
                total=None, face_count=None, spacing=spacing, share=self.share, colors=max(colors)
            )
        else:
            # of the paper's cells two fifths of all pores lie on the faces, three faces counted
            on_faces = self.count if self.count is not None else round(0.44 * (self.total or 0))
        thrown = on_faces / 3 * sum(colors)
        cell = replace(cell, face_pores=float(on_faces), interiors=palette.interiors, colors=colors)
        return Size(pores=thrown, design=cell)

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        """Throw the patterns of all colors."""
        from sppm_pipeline.numerics.sampling.faces import mirrored_faces, split_between_faces_and_interior

        cell, base = start_of(self.edge, pores, context.palette.interiors)
        if base.has_faces:
            raise ConfigError("the faces carry pores already", hint="use one face sampler a recipe")
        if context.palette.blocks is not None:
            return self._scattered(context, base, context.palette.blocks)
        colors = context.palette.colors
        count, spacing = split_between_faces_and_interior(
            total=self.total,
            face_count=self.count,
            spacing=None if self.spacing is None else cell.fraction(self.spacing),
            share=self.share,
            colors=max(colors),
        )
        margin = None if self.margin is None else cell.fraction(self.margin)
        if margin is not None and not (spacing / 2 if max(colors) > 1 else 0) <= margin < 0.5:
            raise ConfigError(
                f"the margin is {margin:g} cell sizes, allowed is less than 0.5"
                + (f" and, with several face colors, at least half the spacing of {spacing:.4g}" * (max(colors) > 1)),
                hint="leave `margin` out for the least that works",
            )
        if max(colors) <= MAX_TOGETHER and len(set(colors)) == 1:
            patterns = mirrored_faces(context.rng(), None, spacing, colors[0], margin=margin, total=count)
        else:
            patterns = self._apart(context, count, spacing, colors, margin)
        flat = [pattern for per_axis in patterns for pattern in per_axis]
        piece = np.repeat(np.arange(len(flat)) + base.interiors, [len(p) for p in flat]).astype(np.int32)
        return base.extended(np.concatenate(flat), piece, colors=colors, spacing=spacing)

    def _scattered(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        """Without faces: the interior sampler takes the total, and a count of face pores is thrown like any others."""
        from sppm_pipeline.numerics.sampling.blocks import spacing_at_share
        from sppm_pipeline.numerics.sampling.faces import split_between_faces_and_interior

        spacing = None if self.spacing is None else base.cell.fraction(self.spacing)
        if self.count is None:
            if spacing is None:
                assert self.total is not None  # by `check_options`
                assert self.share is not None
                spacing = spacing_at_share(self.total, self.share)
            return replace(base, spacing=spacing)
        count, spacing = split_between_faces_and_interior(
            total=None, face_count=self.count, spacing=spacing, share=self.share, colors=1
        )
        return with_darts(context, base, blocks, count, spacing)

    def _apart(
        self, context: Context, count: int, spacing: float, colors: tuple[int, int, int], margin: float | None
    ) -> list[list[NDArray[np.float64]]]:
        """Patterns so far from the border of the face that those of perpendicular faces need not be looked at."""
        from sppm_pipeline.numerics.sampling.darts import throw
        from sppm_pipeline.numerics.sampling.faces import face_counts

        free = spacing / np.sqrt(2)
        if margin is not None and margin < free:
            raise ConfigError(
                f"the margin of {margin:g} cell sizes is too small for this many face patterns; the least is {free:.4g}"
            )
        border = margin or free
        if border >= 0.5:
            raise DesignError(
                f"this many face patterns keep {border:.4g} cell sizes from the border, which leaves no face",
                hint="choose a smaller spacing",
            )
        lower, upper = np.full(3, border), np.full(3, 1 - border)
        patterns = []
        for axis, counts in enumerate(face_counts(count, max(colors))):
            low, high = lower.copy(), upper.copy()
            low[axis] = high[axis] = 0.0
            patterns.append(
                [throw(context.rng(axis, k), int(counts[k]), spacing, low, high) for k in range(colors[axis])]
            )
        return patterns
