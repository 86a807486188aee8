"""``write.svg``: contours of the layers as vector pictures, one a layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline import SliceStack, options
from sppm_pipeline.features.printing.contour_writer import ContourWriter
from sppm_pipeline.services.arrays import F64


@dataclass(frozen=True, kw_only=True)
class WriteSvg(ContourWriter):
    """Write a folder of SVG files, black where solid, in millimeters, with a manifest beside them.

    File ``00000.svg`` is the lowest layer. The picture is the box of the part, its upper edge the side of largest y, as
    one looks down on the build plate.
    """

    name: ClassVar[str] = "write.svg"
    suffix: ClassVar[str] = ".svg"

    path: str = options.write_path("contours", suffixes=("/",))

    def encode_contours(self, rings: Sequence[F64], stack: SliceStack) -> bytes:
        (nx, ny, _), (hx, hy), (x, y, _) = stack.shape, stack.pixel_mm, stack.origin_mm
        wide, high = f"{nx * hx:.6f}", f"{ny * hy:.6f}"
        outlines = []
        for ring in rings:
            # y points down in a picture
            corners = " ".join(f"{a - x:.6f},{y + ny * hy - b:.6f}" for a, b in ring.tolist())
            outlines.append(f"M{corners}Z")
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}mm" height="{high}mm" viewBox="0 0 {wide} {high}">'
            f'<path fill-rule="evenodd" d="{" ".join(outlines)}"/></svg>\n'
        ).encode()

    def encoding(self, stack: SliceStack) -> dict[str, Any]:
        return {"unit": "mm"}
