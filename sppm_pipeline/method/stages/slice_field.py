"""``slice.field``: layers straight from the field, without a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Length, Palette, Part, ScalarField, Size, SliceStack, Stage, options
from sppm_pipeline.method.nouns.printer import Printer, cut_for
from sppm_pipeline.method.slicing.sampled_slices import FieldSlices
from sppm_pipeline.method.slicing.slice_stack import stack_size
from sppm_pipeline.nouns.length import Pixel
from sppm_pipeline.services.grid import Grid, covering_voxels


@dataclass(frozen=True, kw_only=True)
class SliceField(Stage):
    """Cut a part or a tiling into layers, each at its mid-height (paper, "Mesh-free Slicing").

    Pixels are anchored at the lattice of the cells. Where they are finer than the tunnels need it, kernels are summed
    on a coarser grid and the sums interpolated, which moves some 3 pixels in 100 000. Layers are computed while they
    are written; memory does not grow with their number. With a `printer`, its pixels are taken, and a part that it
    can't hold is refused.
    """

    name: ClassVar[str] = "slice.field"
    version: ClassVar[int] = 2
    advice: ClassVar[str] = "give a larger `pixel` or `layer`"

    pixel: Pixel | None = options.pixel(None)
    layer: Length | None = options.layer(None)
    resolution: int | None = options.resolution(None, note="instead of `pixel` and `layer`", maximum=2048)
    printer: str | None = options.printer(None, note="sets `pixel`")
    cards: Path | None = options.cards(None)
    islands: str = options.islands("auto", note="a part decides for itself")
    gray: int = options.gray(1, formerly="grey")
    gray_layers: int = options.gray_layers(1)
    exact: bool = options.exact(False)

    def check_options(self) -> None:
        if (self.pixel is None and self.printer is None) == (self.resolution is None):
            raise ConfigError("give one of `printer`, `pixel` and `resolution`")
        if self.resolution is not None and self.layer is not None:
            raise ConfigError("`layer` belongs to `pixel`; with `resolution` layers are as high as pixels are wide")
        self._cut(1.0)

    def _cut(self, edge: float) -> tuple[Printer | None, tuple[float, float, float]]:
        """The printer, and pixel pitch along x and y and layer height, mm."""
        pixel = self.pixel if self.resolution is None else Length(edge / self.resolution)
        return cut_for(self.printer, self.cards, pixel, self.layer)

    def estimate(self, palette: Palette, field: Size) -> Size:
        body = replace(field.body, coarse=math.inf) if self.exact else field.body
        made = stack_size(body, self._cut(body.scale)[1], self.gray, self.gray_layers, self.islands != "keep")
        return replace(made, design=field.design)

    def run(self, context: Context, field: ScalarField) -> SliceStack:
        """Place the pixels; nothing is computed yet."""
        edge = field.physical_edge()
        printer, pitch = self._cut(edge)
        if isinstance(field, Part):
            low = [(v - o) / edge for v, o in zip(field.domain.lower, field.origin_mm, strict=True)]
            high = [(v - o) / edge for v, o in zip(field.domain.upper, field.origin_mm, strict=True)]
        else:
            low, high = [0.0] * 3, [float(c) for c in field.cells]
        hx, hy, hz = (h / edge for h in pitch)
        (i, j, k), shape = covering_voxels(low, high, (hx, hy, hz))  # counted from the lattice origin
        ox, oy, oz = field.origin_mm
        if (coarse := field.coarseness(max(hx, hy, hz))) is not None:
            context.warn(coarse)
        samples = (pitch[0] / self.gray, pitch[1] / self.gray, pitch[2] / self.gray_layers)
        if isinstance(field, Part) and (gap := field.skin_gap(samples)) is not None:
            context.warn(gap)
        stack = FieldSlices(
            source=field.exactly() if self.exact else field,
            grid=Grid(((i + 0.5) * hx, (j + 0.5) * hy, (k + 0.5) * hz), (hx, hy, hz), shape), pitch=pitch,
            lower=(ox + i * hx * edge, oy + j * hy * edge, oz + k * hz * edge),
            islands=field.islands if isinstance(field, Part) else self.islands, subsamples=self.gray,
            sublayers=self.gray_layers, machine=printer,
        )  # fmt: skip
        return stack.require_room(self.cards)
