"""Voxel images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.noun import Noun

__all__ = ["Voxels"]


@dataclass(frozen=True, eq=False)
class Voxels(Noun):
    """A binary image of a structure.

    Attributes
    ----------
    solid : (nx, ny, nz) bool
        Indexed x, y, z; x is contiguous in memory.
    spacing : float
        Edge of a voxel, mm, or cell edges if `physical` is False.
    physical : bool
    periodic : tuple of 3 bools
        Whether opposite sides are neighbours.
    """

    solid: NDArray[np.bool_]
    spacing: float
    physical: bool
    periodic: tuple[bool, bool, bool]

    def __post_init__(self) -> None:
        solid = np.asfortranarray(self.solid, bool)
        if solid.flags.writeable:
            solid = solid.copy(order="F")
            solid.setflags(write=False)
        object.__setattr__(self, "solid", solid)

    def check(self) -> None:
        """Three axes, at least one voxel, a positive spacing."""
        if self.solid.ndim != 3 or not self.solid.size:
            raise ValueError(f"voxels need three axes, got shape {self.solid.shape}")
        if not self.spacing > 0:
            raise ValueError(f"the voxel edge must be positive, got {self.spacing}")

    def summary(self) -> dict[str, Any]:
        """Shape and porosity."""
        return {
            "shape": list(self.solid.shape),
            "spacing": self.spacing,
            "unit": "mm" if self.physical else "cell edges",
            "porosity": 1 - float(np.count_nonzero(self.solid)) / self.solid.size,
        }
