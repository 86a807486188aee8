"""A periodic field without its floating islands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.artifact import frozen
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import Grid


@dataclass(frozen=True, eq=False)
class CleanedField(ScalarField):
    """A field in whose floating islands the sign is turned, so that they become void.

    Islands were found on a voxel grid; a sample belongs to an island if its voxel, or one beside it that is no solid
    which stays, does. Turning the sign keeps the field continuous, as it is zero where the island ends.

    Attributes
    ----------
    base : ScalarField
    floating : (nz, ny, nx) uint8
        1 in voxels of islands and beside them, n voxels along a cell edge.
    per_cell : int
        n.
    """

    base: ScalarField
    floating: NDArray[np.uint8]
    per_cell: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "floating", frozen(np.asarray(self.floating, np.uint8)))

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.base.cells

    @property
    def periodic(self) -> bool:
        return self.base.periodic

    @property
    def finest_radius(self) -> float | None:
        return self.base.finest_radius

    @property
    def edge_mm(self) -> float | None:
        return self.base.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.base.origin_mm

    def sample(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        return self.sample_layers(grid, 0, grid.shape[2], threads)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        values = self.base.sample_layers(grid, start, stop, threads)
        nz, ny, nx = self.floating.shape
        place = []
        for axis, n in ((2, nz), (1, ny), (0, nx)):
            voxel = np.floor(grid.axis(axis) * self.per_cell + 1e-9).astype(np.int64)
            place.append(voxel % n if self.periodic else np.clip(voxel, 0, n - 1))
        place[0] = place[0][start:stop]
        turned = self.floating[np.ix_(*place)].view(bool)
        turned &= values < 0
        np.negative(values, out=values, where=turned)
        return values

    def summary(self) -> dict[str, Any]:
        """That of the field it was made from."""
        return self.base.summary()
