"""``write.section``: the values of a field on a plane, with level curves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Palette, ScalarField, Size, Stage, option, options
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.arrays import F64, U8
from sppm_pipeline.services.grid import Grid

MAX_PIXELS = 4096
"""Pixels along the longer side."""

CURVE = 1.1
"""Half width of a level curve in pixels."""

HIGHEST = 1.5
"""Largest value that has a color of its own where kernels are summed, whose highest sums would hide all others; a
single pore or tunnel has 1."""


@dataclass(frozen=True, kw_only=True)
class WriteSection(Stage):
    """Draw the values of a field on a plane across an axis, with its level curves.

    Of pores and tunnels the sum G of all kernels is shown (paper, equations 1 to 3), of which the surface of the solid
    is the level C; of any other field its values, of which the surface is the level 0. Each level's share of the plane
    on which values are larger is reported, in the order of `levels`; without `levels` there is one curve, the surface.
    """

    name: ClassVar[str] = "write.section"
    advice: ClassVar[str] = "ask for fewer pixels"
    reported: ClassVar[tuple[str, ...]] = ("share_above.*", "lowest", "highest")

    path: str = options.write_path("section.png", suffixes=(".png",))
    axis: str = options.axis("z", note="the plane lies across it")
    position: float = option(
        0.5, help="place of the plane along this axis", unit="cell sizes", minimum=-1e4, maximum=1e4
    )
    levels: tuple[float, ...] = option(
        (), help="values whose curves are drawn, in blue, green, yellow and so on", minimum=-1e9, maximum=1e9
    )
    pixels: int = option(480, help="pixels along the longer side of the section", minimum=16, maximum=MAX_PIXELS)

    def check_options(self) -> None:
        """Each level once, and no more than have a color of their own."""
        if len(set(self.levels)) < len(self.levels) or len(self.levels) > len(_CURVES):
            raise ConfigError(f"`levels` names up to {len(_CURVES)} different values, got {list(self.levels)}")

    def estimate(self, palette: Palette, field: Size) -> Size:
        grid = field.grid(float(self.pixels))
        pixels = float(self.pixels) ** 2
        return Size(pixels=pixels, samples=pixels, sums=grid.sums / max(1.0, grid.samples) * pixels, resident=pixels)

    def run(self, context: Context, field: ScalarField) -> None:
        """Sample and draw."""
        from PIL import Image

        from sppm_pipeline.services.pictures.sheets import colors_of, with_scale

        values = plane_of(field, "xyz".index(self.axis), self.position, self.pixels, context.threads)
        summed = None if isinstance(field, Part) else field.sum_level  # beyond a part there is no sum
        if summed is not None:
            values = values + summed
        levels = self.levels or ((0.0,) if summed is None else (summed,))
        low, high = float(values.min()), float(values.max())
        shown = (0.0, min(high, HIGHEST)) if summed is not None else (low, high)
        picture = colors_of(values.ravel(), *shown).reshape(*values.shape, 3)
        for level, color in zip(levels, _CURVES, strict=False):
            picture = with_curve(picture, values, level, color)
        names = ", ".join(f"{level:g}" for level in levels)
        picture = with_scale(picture, *shown, f"curves: {names}", max(110, len(names) * 8 + 80))
        Image.fromarray(picture).save(context.output(self.path))
        context.report(
            share_above={str(n): float((values > level).mean()) for n, level in enumerate(levels, 1)},
            lowest=low,
            highest=high,
        )


_CURVES = tuple(
    (int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16))
    for color in ("#1040e0", "#00a040", "#f0d000", "#d55e00", "#cc79a7", "#e69f00", "#56b4e9")
)
"""Blue, green and yellow as in the paper's figure, then those of charts."""


def plane_of(field: ScalarField, axis: int, at: float, pixels: int, threads: int) -> F64:
    """Values on a plane across an axis, (rows, columns), the first remaining axis to the right and the other one up."""
    across, up = (a for a in range(3) if a != axis)
    wide, high = field.cells[across], field.cells[up]
    step = max(wide, high) / pixels
    shape, origin = [1, 1, 1], [0.0, 0.0, 0.0]
    for a, cells in ((across, wide), (up, high)):
        shape[a], origin[a] = max(1, round(cells / step)), step / 2
    origin[axis] = at
    grid = Grid((origin[0], origin[1], origin[2]), (step, step, step), (shape[0], shape[1], shape[2]))
    values = np.asarray(field.exactly().sample(grid, threads), np.float64).squeeze(axis)
    return np.ascontiguousarray(values.T[::-1])


def with_curve(picture: U8, values: F64, level: float, color: tuple[int, int, int]) -> U8:
    """The picture (h, w, 3) with the curve on which `values` (h, w) are `level`; nothing where they have no slope."""
    slope = np.hypot(*np.gradient(values))
    # the distance to the curve in pixels, to first order, so that curves are as wide on steep slopes as on flat ones
    away = np.abs(values - level) / np.maximum(slope, 1e-12)
    opacity = np.clip(CURVE + 0.5 - away, 0.0, 1.0)[..., None] * (slope > 0)[..., None]
    return np.asarray(np.rint(picture * (1 - opacity) + np.array(color) * opacity), np.uint8)
