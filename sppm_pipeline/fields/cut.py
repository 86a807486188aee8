"""A field cut at another value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid


@dataclass(frozen=True, eq=False)
class CutField(ScalarField):
    """A field less a constant: solid where the field is smaller than `value`.

    What `ScalarField.cut_at` makes of a field that knows no better name for it, such as a radius or a level.

    Attributes
    ----------
    base : ScalarField
    value : float
        In the unit of the field.
    """

    base: ScalarField
    value: float

    def check(self) -> None:
        """The value is a number."""
        if not np.isfinite(self.value):
            raise ValueError(f"a field is cut at a finite value, got {self.value}")

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.base.cells

    @property
    def periodic(self) -> bool:
        return self.base.periodic

    @property
    def edge_mm(self) -> float | None:
        return self.base.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.base.origin_mm

    def cut_at(self, value: float) -> CutField:
        return replace(self, value=self.value + value)

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        return self._less(self.base.sample(grid, threads))

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self._less(self.base.sample_layers(grid, start, stop, threads))

    def _less(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        values -= np.float32(self.value)
        return values

    def summary(self) -> dict[str, Any]:
        """That of the field, and where it is cut."""
        return {**self.base.summary(), "cut": self.value}
