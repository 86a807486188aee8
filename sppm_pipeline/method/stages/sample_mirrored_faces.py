"""``sample.mirrored_faces``: equal pores on opposite faces, so that the cell is periodic."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Cell, Context, Length, Palette, PoreSet, Size, Stage, option, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.families.sampler import design_of, start_of
from sppm_pipeline.method.families.scattered import with_darts
from sppm_pipeline.nouns.palette import Blocks
from sppm_pipeline.services.arrays import F64


@dataclass(frozen=True, kw_only=True)
class MirroredFaces(Stage):
    """Throw pores on the faces of the cell; opposite faces carry the same pattern (paper, "Boundary Periodicity").

    Each pattern keeps the spacing to itself, repeated in its plane, and to the patterns of the perpendicular faces of
    every color. Pores lie on the edges and corners of the cell, too, and faces get as many as make the solid share of
    an assembly level. With ``faces_margin: paper`` edges and corners stay free: with several colors pores keep a margin
    from the border of the face, so that four cells of any colors may meet at an edge, and solid bars show there.
    """

    name: ClassVar[str] = "sample.mirrored_faces"
    is_random: ClassVar[bool] = True

    count: int | None = options.count(
        None, note="on the faces, edges and corners of one cell, those that are shared counted once"
    )
    total: int | None = options.total(None, note="the faces get their share")
    spacing: Length | None = options.spacing(None)
    share: float | None = options.share(None)
    faces_margin: str = option(
        "homogeneous",
        help="homogeneous: pores on edges and corners, and as many on the faces as make the solid share level; "
        "paper: no pores near the edges, and as many on the faces as are packed as densely as the interior",
        choices=("homogeneous", "paper"),
    )
    margin: Length | None = option(
        None,
        help="distance of face pores from the border of the face, with `faces_margin: paper`; with several colors at "
        "least half the spacing", unit="cell size", minimum=0, maximum=1e6,
    )  # fmt: skip
    edge: Length | None = options.edge(
        None, note="a number without a unit only says in what unit of length `omega` and `mu` are given, 1 if omitted",
        unit=None, above=None, minimum=1e-6, maximum=1e6,
    )  # fmt: skip

    def check_options(self) -> None:
        if self.count is not None and self.total is not None:
            raise ConfigError("`count` and `total` exclude each other")
        given = sum(v is not None for v in (self.spacing, self.share, self.count if self.total is None else self.total))
        if given != 2:
            raise ConfigError(
                "give two of: the number of pores (`count` or `total`), `spacing`, `share`",
                hint="for example `count: 18` and `spacing: 0.16`, or `total: 110` and `share: 0.5`",
            )

        if self.margin is not None and self.faces_margin != "paper":
            raise ConfigError(
                "`margin` keeps the pores of the faces away from edges that carry none",
                hint="give `faces_margin: paper` with it, or leave it out",
            )

    def estimate(self, palette: Palette, pores: Size | None) -> Size:
        colors = palette.colors
        cell = pores.cell if pores else design_of(self.edge)
        if self.faces_margin != "paper":
            from sppm_pipeline.method.sampling.edges import homogeneous_counts

            met = _met(palette)
            total, fraction = self._homogeneous(None if self.spacing is None else cell.cell.fraction(self.spacing), met)
            on_faces = self.count if self.count is not None else sum(homogeneous_counts(total, fraction, met))
        elif self.total is None and self.count is None:
            from sppm_pipeline.method.sampling.faces import split_between_faces_and_interior

            spacing = None if self.spacing is None else cell.cell.fraction(self.spacing)
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
        cell, base = start_of(self.edge, pores, context.palette.interiors)
        if base.has_faces:
            raise ConfigError("the faces carry pores already", hint="use one face sampler a recipe")
        if context.palette.blocks is not None:
            return self._scattered(context, base, context.palette.blocks)
        colors = context.palette.colors
        if self.faces_margin == "paper":
            if context.palette.face_totals is not None:
                raise ConfigError(
                    "faces with numbers of pores of their own need pores on the edges", hint="leave out `faces_margin`"
                )
            patterns, spacing = self._packed(context, cell)
        else:
            from sppm_pipeline.method.sampling.edges import homogeneous_faces

            met = _met(context.palette)
            total, spacing = self._homogeneous(None if self.spacing is None else cell.fraction(self.spacing), met)
            totals = context.palette.face_totals
            patterns = homogeneous_faces(
                context.rng(), total, spacing, colors, face_count=self.count, met=met, totals=totals,
                threads=context.threads,
            )  # fmt: skip
        flat = [pattern for per_axis in patterns for pattern in per_axis]
        piece = np.repeat(np.arange(len(flat)) + base.interiors, [len(p) for p in flat]).astype(np.int32)
        return base.extended(np.concatenate(flat), piece, colors=colors, spacing=spacing)

    def _homogeneous(self, spacing: float | None, met: int = 1) -> tuple[float, float]:
        """Number of pores of a cell and their spacing, cell sizes."""
        from sppm_pipeline.method.sampling.edges import homogeneous_design

        return homogeneous_design(total=self.total, face_count=self.count, spacing=spacing, share=self.share, met=met)

    def _packed(self, context: Context, cell: Cell) -> tuple[list[list[F64]], float]:
        """Patterns without edges, packed as densely as the interior, and their spacing."""
        from sppm_pipeline.method.sampling.edges import MAX_TOGETHER
        from sppm_pipeline.method.sampling.faces import mirrored_faces, split_between_faces_and_interior

        colors = context.palette.colors
        count, spacing = split_between_faces_and_interior(
            total=self.total, face_count=self.count,
            spacing=None if self.spacing is None else cell.fraction(self.spacing), share=self.share, colors=max(colors),
        )  # fmt: skip
        margin = None if self.margin is None else cell.fraction(self.margin)
        if margin is not None and not (spacing / 2 if max(colors) > 1 else 0) <= margin < 0.5:
            raise ConfigError(
                f"the margin is {margin:g} cell sizes, allowed is less than 0.5"
                + (f" and, with several face colors, at least half the spacing of {spacing:.4g}" * (max(colors) > 1)),
                hint="leave `margin` out for the least that works",
            )
        if max(colors) <= MAX_TOGETHER and len(set(colors)) == 1:
            return mirrored_faces(context.rng(), count, spacing, colors[0], margin), spacing
        return self._apart(context, count, spacing, colors, margin), spacing

    def _scattered(self, context: Context, base: PoreSet, blocks: Blocks) -> PoreSet:
        """Without faces: the interior sampler takes the total, and a count of face pores is thrown like any others."""
        from sppm_pipeline.method.sampling.blocks import spacing_at_share
        from sppm_pipeline.method.sampling.faces import split_between_faces_and_interior

        spacing = None if self.spacing is None else base.cell.fraction(self.spacing)
        if self.count is None:
            if spacing is None:
                assert self.total is not None  # by `check_options`
                assert self.share is not None
                spacing = spacing_at_share(self.total, self.share)
            return replace(base, spacing=spacing)
        if spacing is None:  # that of the cell
            _, spacing = (
                split_between_faces_and_interior(
                    total=None, face_count=self.count, spacing=None, share=self.share, colors=1
                )
                if self.faces_margin == "paper"
                else self._homogeneous(None)
            )
        return with_darts(context, base, blocks, self.count, spacing)

    def _apart(
        self, context: Context, count: int, spacing: float, colors: tuple[int, int, int], margin: float | None
    ) -> list[list[F64]]:
        """Patterns so far from the border of the face that those of perpendicular faces need not be looked at."""
        from sppm_pipeline.method.sampling.cell_list import new_stream
        from sppm_pipeline.method.sampling.faces import face_counts
        from sppm_pipeline.method.sampling.many import faces_apart

        free = spacing / np.sqrt(2)
        if margin is not None and margin < free:
            raise ConfigError(
                f"the margin of {margin:g} cell sizes is too small for this many face patterns; the least is {free:.4g}"
            )
        streams = [np.concatenate([new_stream(context.rng(axis, k)) for k in range(colors[axis])]) for axis in range(3)]
        counts = face_counts(count, max(colors))
        return faces_apart(streams, counts, spacing, margin or free, threads=context.threads)


def _met(palette: Palette) -> int:
    """Face patterns that an interior may meet on one side."""
    return max(palette.colors) if palette.meetings is None else 1
