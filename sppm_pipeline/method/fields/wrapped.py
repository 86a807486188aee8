"""Fields made from another field: without floating islands, repeated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sppm_pipeline.method.fields.scalar_field import WrappedField
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.arrays import F32, I32, U8
from sppm_pipeline.services.grid import Grid


@dataclass(frozen=True, eq=False)
class CleanedField(WrappedField):
    """A field whose floating islands are void: the sign is inverted there.

    Islands were found on a voxel grid; a sample belongs to an island if its voxel, or one beside it that is not solid
    which stays, does. Inverting the sign keeps the field continuous, as it is zero where the island ends.
    """

    floating: U8  # (nz, ny, nx), 1 in voxels of islands and beside them
    per_cell: int  # voxels along a cell edge

    def __post_init__(self) -> None:
        object.__setattr__(self, "floating", frozen(np.asarray(self.floating, np.uint8)))

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        values = self.base.sample_zyx(grid, start, stop, threads)
        nz, ny, nx = self.floating.shape
        place = []
        for axis, n in ((2, nz), (1, ny), (0, nx)):
            # samples on the border of two voxels belong to the upper one, whatever their rounding
            voxel = np.floor(grid.axis(axis) * self.per_cell + 1e-9).astype(np.int64)
            place.append(voxel % n if self.periodic else np.clip(voxel, 0, n - 1))
        place[0] = place[0][start:stop]
        inverted = self.floating[np.ix_(*place)].view(bool)
        # only the solid is inverted: void beside an island stays void
        inverted &= values < 0
        return np.where(inverted, -values, values).T


@dataclass(frozen=True, eq=False)
class RepeatedField(WrappedField):
    """Any field that is periodic with one cell, taken as the content of a whole lattice."""

    extent: tuple[int, int, int]  # cells of the lattice
    edge: float | None  # of a cell, mm
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world position of the low corner of cell (0, 0, 0), mm

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.extent

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self.base.sample_layers(grid, start, stop, threads)

    def solid_layers(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> U8:
        return self.base.solid_layers(grid, start, stop, threads, wanted)

    def summary(self) -> dict[str, Any]:
        """Size of the lattice."""
        return {"lattice": list(self.extent), "cell_mm": self.edge}
