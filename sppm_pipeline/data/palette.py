"""The number of interiors and face colors that a recipe draws together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Palette:
    """The interiors and face patterns that samplers and connectors have to supply.

    A lone periodic cell asks for one interior and one color. Interior t may meet any color on each of its six
    sides, unless `meetings` lists the combinations that occur.

    Attributes
    ----------
    interiors : int
        K, the number of interiors.
    colors : tuple of 3 ints
        The number of face patterns perpendicular to x, y, z.
    meetings : (p, 4) int64 or None
        Rows (interior, axis, side, color); side 0 is the low face. None: all combinations.
    """

    interiors: int = 1
    colors: tuple[int, int, int] = (1, 1, 1)
    meetings: NDArray[np.int64] | None = None

    def all_meetings(self) -> NDArray[np.int64]:
        """The rows of `meetings`, written out, (p, 4) int64."""
        if self.meetings is not None:
            return self.meetings
        rows = [
            np.stack(
                np.meshgrid(np.arange(self.interiors), [axis], [0, 1], np.arange(self.colors[axis]), indexing="ij"), -1
            )
            for axis in range(3)
        ]
        return np.concatenate([r.reshape(-1, 4) for r in rows]).astype(np.int64)
