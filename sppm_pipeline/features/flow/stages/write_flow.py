"""``write.flow``: the speed of a fluid in the pores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Stage, options
from sppm_pipeline.features.flow.permeability import PermeabilityReport


@dataclass(frozen=True, kw_only=True)
class WriteFlow(Stage):
    """Draw the speed of the flow through a cell in a plane through its middle.

    The fluid is driven along an axis, which points to the right; the next axis (y, z, x) points up. Colors are the
    speed over the mean velocity of the cell, solid is white.
    """

    name: ClassVar[str] = "write.flow"
    advice: ClassVar[str] = "give a smaller `image_size`"

    path: str = options.write_path("flow.png", suffixes=(".png",))
    axis: str = options.axis("x")
    image_size: tuple[int, int] = options.image_size((900, 760), minimum=300)

    def run(self, context: Context, report: PermeabilityReport) -> None:
        """Draw and write."""
        from PIL import Image

        axis = "xyz".index(self.axis)
        if not report.wraps[axis]:
            context.warn(f"nothing flows along {self.axis}: the picture shows the pores only")
        Image.fromarray(report.picture(axis, self.image_size)).save(context.output(self.path))
