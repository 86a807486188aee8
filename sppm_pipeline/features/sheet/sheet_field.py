"""Fields of a sheet between two networks: relaxed in a cell, or as it is summed of kernels in any layout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.sheet.numerics.waves import Waves, sum_of_waves
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.assembly.gather import Catalog, make_catalog, sample_exact
from sppm_pipeline.method.fields.microstructure import CUTOFF, Microstructure, sampling_tables
from sppm_pipeline.nouns import FormulaField
from sppm_pipeline.nouns.artifact import frozen
from sppm_pipeline.services.grid import Grid


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


@dataclass(frozen=True, eq=False, kw_only=True)
class SheetMicrostructure(Microstructure):
    """Solid where the kernel sums of pores of two colors nearly balance, for blocks of scattered pores.

    ``|G_1 - G_2 - middle|`` takes the place of the kernel sum G of other microstructures, and the level is the half
    width of the sheet in its values.
    """

    reported: ClassVar[tuple[str, ...]] = (*Microstructure.reported, "middle", "thinnest_wall")
    counted: ClassVar[bool] = False

    colors_of_pores: NDArray[np.int8]  # 1 or -1 of each kernel, in the order of `pieces`
    middle: float
    slope: float  # of G_1 - G_2, as in `SheetField`

    def __post_init__(self) -> None:
        object.__setattr__(self, "colors_of_pores", frozen(np.asarray(self.colors_of_pores, np.int8)))

    def check(self) -> None:
        """A color for every pore."""
        super().check()
        if self.colors_of_pores.shape != self.pieces.kernels.omega.shape or (abs(self.colors_of_pores) != 1).any():
            raise ValueError("every pore of a sheet has the color 1 or -1")

    @property
    def additive(self) -> bool:
        return False

    @property
    def coarse_pitch(self) -> None:
        """None: a sheet has a crease in its middle, across which nothing may be interpolated."""
        return None

    @property
    def finest_radius(self) -> None:
        return None

    @property
    def thinnest_wall(self) -> float | None:
        return 2 * self.level / self.slope if self.slope > 0 else None

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self.alone(0, (0, 0, 0)).own_values(grid, start, stop, threads)

    def laid_differences(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1,
        wanted: NDArray[np.int32] | None = None,
    ) -> NDArray[np.float32]:  # fmt: skip
        """The difference of the kernel sums of both colors in some layers of a layout, (stop - start, ny, nx)."""
        sums = [
            sample_exact(pieces, arrays, grid, CUTOFF, threads, start, stop, wanted=wanted, catalog=catalog).T
            for pieces, catalog in self._networks()
        ]
        return np.asarray(sums[0] - sums[1])

    def laid_sums(
        self, arrays: TilingArrays, grid: Grid, start: int, stop: int, threads: int = 1,
        wanted: NDArray[np.int32] | None = None,
    ) -> NDArray[np.float32]:  # fmt: skip
        """Half width of the sheet from which on each sample of a layout is solid."""
        values = self.laid_differences(arrays, grid, start, stop, threads, wanted)
        values -= np.float32(self.middle)
        return np.abs(values, out=values)

    def _networks(self) -> list[tuple[Pieces, Catalog]]:
        """The pieces of both colors with their catalogs, made once for all levels."""
        tables = sampling_tables(self.pieces)
        if "networks" not in tables:
            tables["networks"] = [
                (pieces, make_catalog(pieces, CUTOFF)) for pieces in (self._of_color(1), self._of_color(-1))
            ]
        found: list[tuple[Pieces, Catalog]] = tables["networks"]
        return found

    def _of_color(self, color: int) -> Pieces:
        own = self.colors_of_pores == color
        before = np.concatenate([[0], np.cumsum(own)])
        return replace(
            self.pieces,
            kernels=self.pieces.kernels.taken(own, slice(None)),
            first_pore=frozen(before[self.pieces.first_pore]),
        )

    def summary(self) -> dict[str, Any]:
        """Numbers of pores, the values between which there is solid, and the thickness of the thinnest tenth."""
        return {**super().summary(), "middle": self.middle, "thinnest_wall": self.thinnest_wall}
