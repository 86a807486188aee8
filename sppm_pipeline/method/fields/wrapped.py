"""Fields made from another field: cut at another value, without floating islands, repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.grid import Grid


@dataclass(frozen=True, eq=False)
class WrappedField(ScalarField):
    """Base of fields made from another field; size, place and finest detail are those of the other one.

    Attributes
    ----------
    base : ScalarField
    """

    base: ScalarField

    def check(self) -> None:
        """The field it was made from is in order; what is evaluated anew is not sampled for this."""
        self.base.check()

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.base.cells

    @property
    def periodic(self) -> bool:
        return self.base.periodic

    @property
    def sum_level(self) -> float | None:
        return self.base.sum_level

    @property
    def finest_radius(self) -> float | None:
        return self.base.finest_radius

    @property
    def thinnest_wall(self) -> float | None:
        return self.base.thinnest_wall

    @property
    def edge_mm(self) -> float | None:
        return self.base.edge_mm

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.base.origin_mm

    def exactly(self) -> Self:
        return replace(self, base=self.base.exactly())

    def summary(self) -> dict[str, Any]:
        """The summary of the field it was made from."""
        return self.base.summary()


@dataclass(frozen=True, eq=False)
class CutField(WrappedField):
    """A field less a constant: solid where the field is smaller than `value`.

    What `ScalarField.cut_at` makes of a field that knows no better name for it, such as a radius or a level.

    Attributes
    ----------
    base : ScalarField
    value : float
        In the unit of the field.
    """

    value: float

    @property
    def sum_level(self) -> float | None:
        level = self.base.sum_level
        return level + self.value if level is not None and level + self.value > 0 else None

    @property
    def finest_radius(self) -> float | None:
        return None

    @property
    def thinnest_wall(self) -> float | None:
        return None

    def check(self) -> None:
        """The value is a number."""
        super().check()
        if not np.isfinite(self.value):
            raise ValueError(f"a field is cut at a finite value, got {self.value}")

    def cut_at(self, value: float) -> CutField:
        return replace(self, value=self.value + value)

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        # a new array: what a field hands out may be its own
        return self.base.sample_layers(grid, start, stop, threads) - np.float32(self.value)

    def summary(self) -> dict[str, Any]:
        """The summary of the field, and the value it is cut at."""
        return {**self.base.summary(), "cut": self.value}


@dataclass(frozen=True, eq=False)
class CleanedField(WrappedField):
    """A field whose floating islands are void: the sign is inverted there.

    Islands were found on a voxel grid; a sample belongs to an island if its voxel, or one beside it that is not solid
    which stays, does. Inverting the sign keeps the field continuous, as it is zero where the island ends.

    Attributes
    ----------
    base : ScalarField
    floating : (nz, ny, nx) uint8
        1 in voxels of islands and beside them, n voxels along a cell edge.
    per_cell : int
        n.
    """

    floating: NDArray[np.uint8]
    per_cell: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "floating", frozen(np.asarray(self.floating, np.uint8)))

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        values = self.base.sample_zyx(grid, start, stop, threads)
        nz, ny, nx = self.floating.shape
        place = []
        for axis, n in ((2, nz), (1, ny), (0, nx)):
            voxel = np.floor(grid.axis(axis) * self.per_cell + 1e-9).astype(np.int64)
            place.append(voxel % n if self.periodic else np.clip(voxel, 0, n - 1))
        place[0] = place[0][start:stop]
        inverted = self.floating[np.ix_(*place)].view(bool)
        inverted &= values < 0
        return np.where(inverted, -values, values).T


@dataclass(frozen=True, eq=False)
class RepeatedField(WrappedField):
    """Any periodic field, taken as the content of a whole lattice.

    Attributes
    ----------
    base : ScalarField
        Periodic with one cell.
    extent : tuple of 3 ints
        Cells of the lattice.
    edge : float or None
        Cell edge, mm.
    origin : tuple of 3 floats
        World position of the low corner of cell (0, 0, 0), mm.
    """

    extent: tuple[int, int, int]
    edge: float | None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.extent

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self.base.sample_layers(grid, start, stop, threads)

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        return self.base.solid_layers(grid, start, stop, threads, wanted)

    def summary(self) -> dict[str, Any]:
        """Size of the lattice."""
        return {"lattice": list(self.extent), "cell_mm": self.edge}
