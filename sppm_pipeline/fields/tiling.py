"""Cells laid side by side, as one field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.fields.kernel_sum import KernelSum, Patches
from sppm_pipeline.fields.microstructure import CUTOFF, sampling_tables
from sppm_pipeline.fields.tileset import TileSet
from sppm_pipeline.numerics.assembly.contents import TilingArrays, check_tiling
from sppm_pipeline.numerics.grid import Grid

USES_OF_A_PATCH = 4
"""How many cells a tiling needs for each patch before sampling the patches is cheaper than summing kernels."""

LASTING_USES = 30
"""Uses of a patch from which it is sampled at the pixels themselves, where these divide the cell: further layers of a
plate, where each of 27 is used 70 times, take 1.6 ns a voxel so, and 2.9 interpolated."""

SMALL_BANK, LARGE_BANK = 256 * 2**20, 768 * 2**20
"""Bytes that the patches of a small tiling, and of one ten times larger, may take; otherwise kernels are summed."""


@dataclass(frozen=True, eq=False)
class Tiling(KernelSum):
    """The content of every cell of a lattice; the field is the sum of all kernels of all cells, shared faces once.

    Attributes
    ----------
    tileset : TileSet
    arrays : TilingArrays
        Interiors and face colors of the lattice.
    edge : float or None
        Cell edge, mm.
    origin : tuple of 3 floats
        World position of the low corner of cell (0, 0, 0), mm.
    exact : bool
        Whether fine grids are summed, too, not interpolated from coarse ones.
    """

    tileset: TileSet
    arrays: TilingArrays
    edge: float | None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exact: bool = False

    def check(self) -> None:
        """Faces fit the cells, every interior and color exists, and interiors only meet colors they were drawn for."""
        check_tiling(self.arrays, self.tileset.micro.pieces)
        if not (self.edge is None or 0 < self.edge < np.inf) or not np.isfinite(self.origin).all():
            raise ValueError(f"the edge of a cell is a positive length, its origin a place: {self.edge}, {self.origin}")
        interior, c = self.arrays.interior, self.tileset.palette_colors
        own = (interior // c**2, interior // c % c, interior % c) if self.tileset.kind == "wang" else None
        for axis in np.flatnonzero(self.tileset.micro.colors):
            for side in range(2):
                self._check_colors(int(axis), side, own[axis] if own is not None else None)

    def _check_colors(self, axis: int, side: int, own: NDArray[np.int32] | None) -> None:
        """Each cell has a face, and of the color its interior stands for, `own`; others have no connectors to it."""
        interior, planes = self.arrays.interior, self.arrays.faces[axis]
        size = interior.shape[axis]
        colors = planes[tuple(slice(side, side + size) if a == axis else slice(None) for a in range(3))]
        wrong = (interior >= 0) & ((colors < 0) if own is None else (colors != own))
        if not wrong.any():
            return
        cell = tuple(np.argwhere(wrong)[0].tolist())
        face = f"its {('low', 'high')[side]} face of axis {axis}"
        if own is None:
            raise ValueError(f"cell {cell} has interior {interior[cell]}, but {face} has no color")
        raise ValueError(
            f"cell {cell} has interior {interior[cell]}, which meets color {own[cell]} on {face}, not {colors[cell]}: "
            f"with c = {self.tileset.palette_colors} colors an interior is (cx c + cy) c + cz"
        )

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
    def thinnest_wall(self) -> float | None:
        return self.tileset.micro.thinnest_wall

    @property
    def edge_mm(self) -> float | None:
        return self.edge

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        return self.origin

    @property
    def solid_below(self) -> float:
        return self.tileset.micro.level

    @property
    def coarse_pitch(self) -> float | None:
        return None if self.exact else self.tileset.micro.coarse_pitch

    def exactly(self) -> Tiling:
        return replace(self, exact=True)

    def kernel_sums(
        self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: NDArray[np.int32] | None = None
    ) -> NDArray[np.float32]:
        return self.tileset.micro.laid_sums(self.arrays, grid, start, stop, threads, wanted)

    @property
    def additive(self) -> bool:
        return self.tileset.micro.additive

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> NDArray[np.float32]:
        return self.tileset.micro.laid_values(self.arrays, grid, start, stop, threads)

    @property
    def patches_last(self) -> bool:
        return self._uses_of_a_patch() >= LASTING_USES

    def _uses_of_a_patch(self) -> float:
        """How many cells there are for each patch."""
        combinations = self.tileset.combinations()
        count = len(combinations) if combinations is not None else self.tileset.micro.pieces.interiors
        return np.count_nonzero(self.arrays.box >= 0) / count

    def patches(self, n: int, offset: float, threads: int = 1) -> Patches | None:
        from sppm_pipeline.numerics.assembly.patches import build_bank, predicted_bytes

        tileset, pieces = self.tileset, self.tileset.micro.pieces
        combinations, uses = tileset.combinations(), self._uses_of_a_patch()
        # a patch is somewhat larger than a cell and is worth sampling if it is used a few times
        if not self.additive or tileset.kind in ("fresh", "scattered") or uses < USES_OF_A_PATCH:
            return None
        tables, key = sampling_tables(pieces), (tileset.kind, tileset.palette_colors, n, offset)
        made = {"offset": offset, "cutoff": CUTOFF}
        if (key, "bytes") not in tables:
            tables[key, "bytes"] = predicted_bytes(pieces, n, combinations, **made)
        if tables[key, "bytes"] > (LARGE_BANK if uses > 10 * USES_OF_A_PATCH else SMALL_BANK):
            return None
        if key not in tables:
            tables[key] = build_bank(pieces, n, combinations, threads=threads, **made)
        return Patches(tables[key], self.arrays)

    def summary(self) -> dict[str, Any]:
        """Size of the lattice and number of filled cells, without those around the part."""
        filled = self.arrays.surrounded().interior
        filled = filled[filled >= 0]
        return {
            "lattice": list(self.cells),
            "filled_cells": filled.size,
            "cell_mm": self.edge,
            "interiors_used": len(np.unique(filled)),
        }
