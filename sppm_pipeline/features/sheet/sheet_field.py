"""The field of a sheet between two networks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.sheet.numerics.waves import Waves, sum_of_waves
from sppm_pipeline.nouns import FormulaField


@dataclass(frozen=True, eq=False, kw_only=True)
class SheetField(FormulaField):
    """Solid where a sum f of waves lies within a half width of the value in the middle of the sheet.

    Attributes
    ----------
    waves : Waves
        Those of f, whose variance is 1.
    middle, half_width : float
        Values of f.
    slope : float
        Length of the gradient of f that nine tenths of the sheet do not exceed, 1 / cell size.
    """

    reported: ClassVar[tuple[str, ...]] = ("waves", "middle", "half_width", "thinnest_wall")

    waves: Waves
    middle: float
    half_width: float
    slope: float

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.floating]:
        values = sum_of_waves(self.waves, x.reshape(-1), y.reshape(-1), z.reshape(-1))
        values -= self.middle
        np.abs(values, out=values)
        values -= self.half_width
        return values

    def cut_at(self, value: float) -> SheetField:
        return replace(self, half_width=self.half_width + value)

    @property
    def thinnest_wall(self) -> float | None:
        # where f is steepest the sheet is thin
        return 2 * self.half_width / self.slope if self.half_width > 0 else None

    def summary(self) -> dict[str, Any]:
        """Number of waves, the values between which there is solid, and the thickness of the thinnest tenth."""
        there = (self.waves.real != 0) | (self.waves.imaginary != 0)
        return {
            "waves": int(np.count_nonzero(there)),
            "middle": self.middle,
            "half_width": self.half_width,
            "thinnest_wall": self.thinnest_wall,
        }
