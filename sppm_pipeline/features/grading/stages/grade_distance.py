"""``grade.distance``: the distance from a surface, a line or a point."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Length, SurfaceMesh, option
from sppm_pipeline.features.grading.grader import Grader
from sppm_pipeline.features.grading.laws import DistanceLaw
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.arrays import F64, I32


@dataclass(frozen=True, kw_only=True)
class GradeDistance(Grader):
    """Make a map of the distance from the surface of the part, or another mesh, from a line, or from a point, in mm.

    Inside of a closed surface distances are positive, outside they are negative; those from an open one, from a line
    and from a point are positive. For another mesh than the part write ``from: {part: id}``.
    """

    name: ClassVar[str] = "grade.distance"

    to: str = option("surface", help="what the distance is measured to", choices=("surface", "line", "point"))
    point: tuple[Length, Length, Length] | None = option(
        None, help="the point, or one of the line", unit="mm", minimum=-1e6, maximum=1e6
    )
    direction: tuple[float, float, float] | None = option(
        None, help="direction of the line, of any length", minimum=-1e6, maximum=1e6
    )

    def check_options(self) -> None:
        super().check_options()
        if (self.point is not None) != (self.to != "surface"):
            raise ConfigError(f"`to: {self.to}` {'takes no' if self.point is not None else 'needs a'} `point`")
        if (self.direction is not None) != (self.to == "line"):
            raise ConfigError(f"`to: {self.to}` {'takes no' if self.direction is not None else 'needs a'} `direction`")
        if self.direction is not None and not math.hypot(*self.direction) > 1e-12:
            raise ConfigError("`direction` has no length", hint="give for example [0, 0, 1]")
        if self.measure not in (None, "mm"):
            raise ConfigError("`measure`: distances are in mm")

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> DistanceLaw:
        """The surface, line or point."""
        unit, none = "mm", np.zeros((0, 3), np.int32)
        if self.point is not None:
            place = np.array([[length.mm() for length in self.point]])
            if self.direction is not None:
                place = np.concatenate([place, place + np.array(self.direction) / math.hypot(*self.direction)])
            return DistanceLaw(self.of, unit, place, none, False)
        return DistanceLaw(self.of, unit, *surface_of(part))


def surface_of(part: SurfaceMesh | None) -> tuple[F64, I32, bool]:
    """Vertices and faces of the part, and whether they have an inside; `ConfigError` without a surface."""
    if part is None or not len(part.faces):
        raise ConfigError("there is no surface to measure the distance to", hint="read a mesh before this stage")
    return part.vertices, part.faces, part.bounds_solid
