"""Cells laid side by side, as one field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.fields.microstructure import CUTOFF
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.numerics.assembly.contents import Pieces, TilingArrays, check_tiling
from sppm_pipeline.numerics.grid import Grid, sample_one_period

if TYPE_CHECKING:
    from sppm_pipeline.numerics.assembly.patches import PatchBank

USES_OF_A_PATCH = 4
"""How many cells a tiling needs for each patch before sampling the patches is cheaper than summing kernels."""

SMALL_BANK, LARGE_BANK = 96 * 2**20, 768 * 2**20
"""Bytes that the patches of a small tiling, and of one ten times larger, may take; otherwise kernels are summed."""

_TABLES: WeakKeyDictionary[Pieces, dict[Any, Any]] = WeakKeyDictionary()


def sampling_tables(pieces: Pieces) -> dict[Any, Any]:
    """What was worked out to sample these kernels: patch banks and a catalog; it is freed with them.

    The level does not enter, so that microstructures that differ in nothing else share the tables.
    """
    return _TABLES.setdefault(pieces, {})


@dataclass(frozen=True, eq=False)
class Tiling(ScalarField):
    """The content of every cell of a lattice; the field is the sum of all kernels of all cells, shared faces once.

    Sampled on a grid that is commensurate with the cells it adds up cached patches; on any other grid it sums the
    kernels themselves. Both agree within the stated cut-off.

    Attributes
    ----------
    tileset : TileSet
    arrays : TilingArrays
        Interiors and face colors of the lattice.
    edge : float or None
        Cell edge, mm.
    origin : tuple of 3 floats
        World position of the low corner of cell (0, 0, 0), mm.
    """

    tileset: TileSet
    arrays: TilingArrays
    edge: float | None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def check(self) -> None:
        """Faces fit the cells, and every interior and color exists."""
        check_tiling(self.arrays, self.tileset.micro.pieces)

    @property
    def cells(self) -> tuple[int, int, int]:
        return self.arrays.shape

    @property
    def periodic(self) -> bool:
        return self.arrays.periodic

    @property
    def finest_radius(self) -> float | None:
        return self.tileset.micro.finest_radius

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin

    def sample_layers(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        values = self._sums(grid, start, stop, threads)
        values -= np.float32(self.tileset.micro.level)
        return values

    def sums(self, grid: Grid, threads: int = 1) -> NDArray[np.float32]:
        """The kernel sum G at the points of `grid`, (nz, ny, nx) float32; `sample` is this less the level."""
        return self._sums(grid, 0, grid.shape[2], threads)

    def _sums(self, grid: Grid, start: int, stop: int, threads: int) -> NDArray[np.float32]:
        def sums(grid: Grid, start: int, stop: int) -> NDArray[np.float32]:
            window = self._window(grid, threads)
            if window is None:
                return self._summed(grid, threads, start, stop, None)
            from sppm_pipeline.numerics.assembly.overlap_add import assemble

            bank, z, x, y = window
            return assemble(bank, self.arrays, z[0] + start, z[0] + stop, *x, *y, threads=threads)

        return sample_one_period(grid, self.cells, start, stop, sums) if self.periodic else sums(grid, start, stop)

    def solid_layers(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.uint8]:
        def solid(grid: Grid, start: int, stop: int) -> NDArray[np.uint8]:
            level = self.tileset.micro.level
            window = self._window(grid, threads)
            if window is None:
                rows = None if self.periodic else wanted
                return (self._summed(grid, threads, start, stop, rows) < np.float32(level)).view(np.uint8)
            from sppm_pipeline.numerics.assembly.overlap_add import assemble_solid

            bank, z, x, y = window
            return assemble_solid(bank, self.arrays, level, z[0] + start, z[0] + stop, *x, *y, threads=threads)

        return sample_one_period(grid, self.cells, start, stop, solid) if self.periodic else solid(grid, start, stop)

    def _summed(
        self, grid: Grid, threads: int, start: int, stop: int, wanted: NDArray[np.int32] | None
    ) -> NDArray[np.float32]:
        """The sum of the kernels themselves."""
        from sppm_pipeline.numerics.assembly.gather import make_catalog, sample_exact

        pieces = self.tileset.micro.pieces
        tables = sampling_tables(pieces)
        if "catalog" not in tables:
            tables["catalog"] = make_catalog(pieces, CUTOFF)
        catalog = tables["catalog"]
        return sample_exact(pieces, self.arrays, grid, CUTOFF, threads, start, stop, wanted=wanted, catalog=catalog)

    def _window(
        self, grid: Grid, threads: int
    ) -> tuple[PatchBank, tuple[int, int], tuple[int, int], tuple[int, int]] | None:
        """The patch bank and the window of voxel indices that `grid` stands for, or None if it is not commensurate."""
        per_cell, first, offset = [], [], []
        for axis in range(3):
            n = round(1 / grid.spacing[axis])
            if n < 2 or abs(n * grid.spacing[axis] - 1) > 1e-9:
                return None
            place = grid.origin[axis] * n
            shift = place - np.floor(place + 1e-6)
            if abs(shift) > 1e-6 and abs(shift - 0.5) > 1e-6:
                return None
            per_cell.append(n)
            offset.append(0.5 if shift > 0.25 else 0.0)
            first.append(round(place - offset[-1]))
        if len(set(offset)) > 1 or len(set(per_cell)) > 1:
            return None
        bank = self._bank(per_cell[0], offset[0], threads)
        if bank is None:
            return None
        x, y, z = ((first[a], first[a] + grid.shape[a]) for a in range(3))
        return bank, z, x, y

    def _bank(self, n: int, offset: float, threads: int) -> PatchBank | None:
        """Patches at n samples a cell edge, or None if summing the kernels is cheaper."""
        from sppm_pipeline.numerics.assembly.patches import build_bank, predicted_bytes

        micro, tables = self.tileset.micro, sampling_tables(self.tileset.micro.pieces)
        key = (self.tileset.kind, self.tileset.palette_colors, n, offset)
        if key not in tables:
            combinations = self.tileset.combinations()
            patches = len(combinations) if combinations is not None else micro.interiors
            cells = int(np.count_nonzero(self.arrays.box >= 0))
            arguments = {"offset": offset, "cutoff": CUTOFF}
            # a patch is somewhat larger than a cell and is worth sampling if it is used a few times
            if self.tileset.kind == "fresh" or cells < USES_OF_A_PATCH * patches:
                return None
            size = predicted_bytes(micro.pieces, n, combinations, **arguments)
            if size > (LARGE_BANK if cells > 10 * USES_OF_A_PATCH * patches else SMALL_BANK):
                return None
            tables[key] = build_bank(micro.pieces, n, combinations, threads=threads, **arguments)
        bank: PatchBank = tables[key]
        return bank

    def summary(self) -> dict[str, Any]:
        """Size of the lattice and number of filled cells."""
        return {
            "lattice": list(self.cells),
            "filled_cells": int((self.arrays.box >= 0).sum()),
            "cell_mm": self.edge,
            "interiors_used": len(np.unique(self.arrays.box[self.arrays.box >= 0])),
        }
