"""Voxel images."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import Artifact


@dataclass(frozen=True, eq=False)
class Voxels(Artifact):
    """An image of a structure: a phase for each voxel, or how much of each voxel is solid.

    Attributes
    ----------
    values : (nx, ny, nz) uint8 or float32
        Indexed x, y, z; x is contiguous in memory. As integers the phase, 0 for void; as floats the fraction of the
        voxel that is solid, from 0 to 1.
    spacing : (sx, sy, sz)
        Edges of a voxel, mm, or cell edges if `physical` is False.
    physical : bool
    periodic : tuple of 3 bools
        Whether opposite sides are neighbors.
    """

    values: NDArray[np.uint8] | NDArray[np.float32]
    spacing: tuple[float, float, float]
    physical: bool
    periodic: tuple[bool, bool, bool]

    def __post_init__(self) -> None:
        values = np.asarray(self.values)
        values = np.asfortranarray(values, np.float32 if values.dtype.kind == "f" else np.uint8)
        if values.flags.writeable:
            values = values.copy(order="F")
            values.setflags(write=False)
        object.__setattr__(self, "values", values)

    def check(self) -> None:
        """Three axes, at least one voxel, a positive spacing, fractions between 0 and 1."""
        if self.values.ndim != 3 or not self.values.size:
            raise ValueError(f"voxels need three axes, got shape {self.values.shape}")
        if not min(self.spacing) > 0:
            raise ValueError(f"the voxel edges must be positive, got {self.spacing}")
        if self.fractions and not (self.values.min() >= 0 and self.values.max() <= 1):
            raise ValueError("solid fractions must lie between 0 and 1")

    @property
    def fractions(self) -> bool:
        """Whether the values are solid fractions, not phases."""
        return self.values.dtype.kind == "f"

    @property
    def shape(self) -> tuple[int, int, int]:
        """Voxels along x, y, z."""
        nx, ny, nz = self.values.shape
        return nx, ny, nz

    def solid(self) -> NDArray[np.bool_]:
        """Which voxels are solid: a phase other than void, or at least half full."""
        return self.values >= 0.5 if self.fractions else self.values > 0

    def summary(self) -> dict[str, Any]:
        """Shape, porosity, and the share of each phase."""
        size = self.values.size
        summary: dict[str, Any] = {
            "shape": list(self.shape),
            "spacing": list(self.spacing),
            "unit": "mm" if self.physical else "cell edges",
        }
        if self.fractions:
            return {**summary, "porosity": 1 - float(self.values.sum(dtype=np.float64)) / size}
        shares = np.bincount(self.values.reshape(-1, order="F"), minlength=2) / size
        return {**summary, "porosity": float(shares[0]), "phases": [float(share) for share in shares[1:]]}
