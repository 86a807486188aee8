"""``warp.sphere``: a box of cells becomes a zone of a spherical shell."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Length, ScalarField, option, options
from sppm_pipeline.features.grading.curved_cells import SphereCells
from sppm_pipeline.features.grading.warper import Warper


@dataclass(frozen=True, kw_only=True)
class WarpSphere(Warper):
    """Bend a box of cells to a zone of a shell around the origin: x goes along the equator, y to the north, z outwards.

    Towards the poles cells get narrower; the zone has to end before them.
    """

    name: ClassVar[str] = "warp.sphere"
    reported: ClassVar[tuple[str, ...]] = ("volume_min", "volume_max")

    inner_radius: Length = options.inner_radius()
    around: float = option(360.0, help="angle that the box fills around the axis", unit="degrees", above=0, maximum=360)
    latitudes: tuple[float, float] = option(
        (-45.0, 45.0), help="latitudes between which the box lies", unit="degrees", minimum=-85, maximum=85
    )

    def check_options(self) -> None:
        if not self.latitudes[0] < self.latitudes[1]:
            raise ConfigError(f"`latitudes: {list(self.latitudes)}` are in the wrong order")

    def wraps(self, field: ScalarField) -> tuple[bool, bool, bool]:
        return (self.around == 360, False, False)

    def curved(self, field: ScalarField) -> SphereCells:
        south, climb = math.radians(self.latitudes[0]), math.radians(self.latitudes[1] - self.latitudes[0])
        around = math.radians(self.around)
        return SphereCells(field.cells, field.physical_edge(), self.inner_radius.mm(), around, south, climb)
