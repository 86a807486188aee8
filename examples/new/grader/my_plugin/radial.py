"""``grade.my_word``: a parameter that changes with the distance from an axis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Grader, SurfaceMesh, option
from sppm_pipeline.nouns import Grading, Law, Place


@dataclass(frozen=True, eq=False)
class RadialLaw(Law):
    """The map: linear from the axis to a radius, and constant outside of it; `center` and `radius` in mm."""

    center: tuple[float, float]
    radius: float
    ends: tuple[float, float]

    def at(self, place: Place) -> NDArray[np.float64]:
        """Values at points (n, 3), mm."""
        distance = np.hypot(*(place.points[:, :2] - self.center).T)
        return np.interp(distance / self.radius, (0, 1), self.ends)


@dataclass(frozen=True, kw_only=True)
class GradeRadial(Grader):
    """Let a parameter go from one value on the axis of the part, which is parallel to z, to another at its side."""

    name: ClassVar[str] = "grade.my_word"

    inside: float = option(help="value on the axis", minimum=-1e15, maximum=1e15)
    outside: float = option(help="value at the side and beyond", minimum=-1e15, maximum=1e15)

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> RadialLaw:
        """The axis is that of the part's box; without a part it is that of the first cell."""
        low, high = (np.zeros(3), np.ones(3)) if part is None else (part.lower, part.upper)
        x, y = ((low + high) / 2).tolist()[:2]
        ends = (self.factor * self.inside, self.factor * self.outside)
        return RadialLaw(self.of, self.unit_of_values, (x, y), float((high - low)[:2].max() / 2), ends)
