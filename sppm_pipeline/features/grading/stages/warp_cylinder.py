"""``warp.cylinder``: a box of cells becomes the wall of a tube."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Length, ScalarField, option, options
from sppm_pipeline.features.grading.curved_cells import CylinderCells
from sppm_pipeline.features.grading.warper import Warper


@dataclass(frozen=True, kw_only=True)
class WarpCylinder(Warper):
    """Bend a box of cells to the wall of a tube around the z axis: x goes around, y along the axis, z outwards.

    The tube stands on z = 0. Cells keep their size along the axis and through the wall; around it they are as long as
    the circumference asks for.
    """

    name: ClassVar[str] = "warp.cylinder"
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    inner_radius: Length = options.inner_radius()
    around: float = option(360.0, help="angle that the box fills around the axis", unit="degrees", above=0, maximum=360)

    def wraps(self, field: ScalarField) -> tuple[bool, bool, bool]:
        return (self.around == 360, False, False)

    def curved(self, field: ScalarField) -> CylinderCells:
        return CylinderCells(field.cells, field.physical_edge(), self.inner_radius.mm(), math.radians(self.around))
