"""``field.my_word``: a wall along Schoen's gyroid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import FieldMaker, option


@dataclass(frozen=True, kw_only=True)
class GyroidSheet(FieldMaker):
    """A wall along the gyroid, between two channels that are mirror images of each other and never meet."""

    name: ClassVar[str] = "field.my_word"

    periods: int = option(1, help="periods of the gyroid along an edge of the cell", minimum=1, maximum=20)
    wall: float = option(
        0.3, help="the wall is where |g| is smaller; its share of the volume is about wall / 1.5", above=0, below=1.4
    )

    def evaluate(self, x: NDArray[np.float64], y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
        """|g| less the bound: negative in the wall. Positions are in cell sizes."""
        a, b, c = (2 * np.pi * self.periods * position for position in (x, y, z))
        g = np.sin(a) * np.cos(b) + np.sin(b) * np.cos(c) + np.sin(c) * np.cos(a)
        return np.abs(g) - self.wall
