"""``slice.field``: layers straight from the field, without a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.families import options
from sppm_pipeline.fields.field_slices import FieldSlices
from sppm_pipeline.fields.part import Part
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.slice_stack import SliceStack, stack_size
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.stage import Context, Stage


@dataclass(frozen=True, kw_only=True)
class SliceField(Stage):
    """Cut a part or a tiling into layers, each at its mid-height (paper, "Mesh-free Slicing").

    Pixels are anchored at the lattice of the cells, so that a pitch which divides the cell size takes the fast path.
    Layers are computed while they are written; memory does not grow with their number.
    """

    name: ClassVar[str] = "slice.field"
    advice: ClassVar[str] = "give a larger `pixel` or `layer`"

    pixel: Length | None = options.pixel(None)
    layer: Length | None = options.layer(None)
    resolution: int | None = options.resolution(None, note="instead of `pixel` and `layer`", maximum=2048)
    islands: str = options.islands("remove", note="a part decides for itself")
    gray: int = options.gray(1, formerly="grey")

    def check_options(self) -> None:
        if (self.pixel is None) == (self.resolution is None):
            raise ConfigError("give one of `pixel` and `resolution`")
        if self.resolution is not None and self.layer is not None:
            raise ConfigError("`layer` goes with `pixel`; with `resolution` layers are as high as pixels are wide")

    def estimate(self, palette: Palette, field: Size) -> Size:
        edge = field.body.scale
        pixel = self.pixel.mm() if self.pixel is not None else edge / (self.resolution or 1)
        layer = self.layer.mm() if self.layer is not None else pixel
        made = stack_size(field.body, pixel, layer, self.gray, passes=2 if self.islands == "remove" else 1)
        return replace(made, design=field.design)

    def run(self, context: Context, field: ScalarField) -> SliceStack:
        """Place the pixels; nothing is computed yet."""
        edge = field.physical_edge()
        pixel = self.pixel.mm() if self.pixel is not None else edge / (self.resolution or 1)
        layer = self.layer.mm() if self.layer is not None else pixel
        if isinstance(field, Part):
            low = [(v - o) / edge for v, o in zip(field.domain.lower, field.origin_mm, strict=True)]
            high = [(v - o) / edge for v, o in zip(field.domain.upper, field.origin_mm, strict=True)]
        else:
            low, high = [0.0] * 3, [float(c) for c in field.cells]
        pitch = (pixel / edge, pixel / edge, layer / edge)
        # whole pixels counted from the lattice origin; a millionth of a pixel is rounding, not part
        first = [math.floor(v / h + 1e-6) for v, h in zip(low, pitch, strict=True)]
        last = [math.ceil(v / h - 1e-6) for v, h in zip(high, pitch, strict=True)]
        nx, ny, nz = (max(1, b - a) for a, b in zip(first, last, strict=True))
        x, y, z = ((a + 0.5) * h for a, h in zip(first, pitch, strict=True))
        ox, oy, oz = (o + a * h * edge for o, a, h in zip(field.origin_mm, first, pitch, strict=True))
        if (coarse := field.coarseness(max(pitch))) is not None:
            context.warn(coarse)
        islands = field.islands if isinstance(field, Part) else self.islands
        grid = Grid((x, y, z), pitch, (nx, ny, nz))
        return FieldSlices(field, grid, pixel, layer, (ox, oy, oz), islands, self.gray)
