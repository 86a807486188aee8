"""Base of writers of contours: closed polylines of a layer, along the sides of its pixels or smooth through grays."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sppm_pipeline import Context, LayerWriter, SliceStack, option
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.services.arrays import F64, U8

HALF = 127.5
"""Gray of pixels that are covered by half."""


@dataclass(frozen=True, kw_only=True)
class ContourWriter(LayerWriter):
    """Base of writers of contours: implement `encode_contours`.

    Contours run along the sides of the pixels, so that they hold exactly the area of these; gray pixels are solid from
    128. With `through_grays` they run through the gray values of the layers (`gray` of the slicing stage) instead,
    where half of a pixel would be covered, by linear interpolation between the middles of pixels. Where pixels meet at
    a corner only, exact contours keep them apart.
    """

    through_grays: bool = option(
        False, help="contours through the grays of the layers instead of along the sides of pixels; needs `gray`"
    )

    @abstractmethod
    def encode_contours(self, rings: Sequence[F64], stack: SliceStack) -> bytes:
        """One layer as bytes, from its contours: (n, 2) float64 each, in mm as the part lies, solid to the left.

        The first point is not repeated at the end.
        """

    def run(self, context: Context, stack: SliceStack) -> None:
        """Write all layers, unless smooth contours are asked for and there are no grays."""
        if self.through_grays and not stack.gray:
            raise ConfigError(
                "smooth contours follow the grays of layers, and these are black and white",
                hint="slice with `gray: 4`, or leave out `through_grays`",
            )
        super().run(context, stack)

    def encode(self, image: U8, stack: SliceStack) -> bytes:
        from sppm_pipeline.services.outlines import level_lines, outlines

        layer = image[::-1]
        rings = level_lines(layer.astype(np.float64), HALF) if self.through_grays else outlines(layer >= 128)
        low, pixel = np.array(stack.origin_mm[:2]), np.array(stack.pixel_mm)
        return self.encode_contours([low + ring * pixel for ring in rings], stack)
