"""Cells laid side by side, as one field."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sppm_pipeline.method.assembly.contents import TilingArrays, check_tiling
from sppm_pipeline.method.fields.kernel_sum import KernelSum, Patches
from sppm_pipeline.method.fields.microstructure import CUTOFF, sampling_tables
from sppm_pipeline.method.fields.scalar_field import Placed
from sppm_pipeline.method.fields.tileset import TileSet
from sppm_pipeline.services.arrays import F32, I32, distinct
from sppm_pipeline.services.grid import Grid

USES_OF_A_PATCH = 4
"""Number of cells that a tiling needs for each patch before sampling the patches is cheaper than summing kernels."""

LASTING_USES = 30
"""Uses of a patch from which it is sampled at the pixels themselves, where these divide the cell: further layers of a
plate, where each of 27 is used 70 times, take 1.6 ns a voxel so, and 2.9 interpolated."""

SMALL_BANK, LARGE_BANK = 256 * 2**20, 768 * 2**20
"""Bytes that the patches of a small tiling, and of one of `LASTING_USES`, may take; otherwise kernels are summed.

Patches of more bytes than those of a small tiling have sixteen bits a sample where only solid and void are
distinguished.
"""


@dataclass(frozen=True, eq=False)
class Tiling(Placed, KernelSum):
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
        # in the paper's set the number of an interior spells the colors of its faces
        own = (interior // c**2, interior // c % c, interior % c) if self.tileset.kind == "wang" else None
        for axis in np.flatnonzero(self.tileset.micro.colors):
            for side in range(2):
                self._check_colors(int(axis), side, own[axis] if own is not None else None)

    def _check_colors(self, axis: int, side: int, own: I32 | None) -> None:
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
    def solid_below(self) -> float:
        return self.tileset.micro.level

    @property
    def coarse_pitch(self) -> float | None:
        return None if self.exact else self.tileset.micro.coarse_pitch

    def exactly(self) -> Tiling:
        return replace(self, exact=True)

    def kernel_sums(self, grid: Grid, start: int, stop: int, threads: int = 1, wanted: I32 | None = None) -> F32:
        return self.tileset.micro.laid_sums(self.arrays, grid, start, stop, threads, wanted)

    @property
    def additive(self) -> bool:
        return self.tileset.micro.additive

    def own_values(self, grid: Grid, start: int, stop: int, threads: int = 1) -> F32:
        return self.tileset.micro.laid_values(self.arrays, grid, start, stop, threads)

    @property
    def patches_last(self) -> bool:
        return self._uses_of_a_patch() >= LASTING_USES

    def _uses_of_a_patch(self) -> float:
        """Mean number of cells for each patch."""
        combinations = self.tileset.combinations()
        count = len(combinations) if combinations is not None else self.tileset.micro.pieces.interiors
        return np.count_nonzero(self.arrays.box >= 0) / count

    def has_patches(self, n: int, offset: float) -> bool:
        uses = self._uses_of_a_patch()
        # a patch is somewhat larger than a cell and is worth sampling if it is used a few times
        # cells that are drawn one by one never repeat
        if not self.additive or self.tileset.kind in ("fresh", "scattered") or uses < USES_OF_A_PATCH:
            return False
        return self._bank_bytes(n, offset) <= (LARGE_BANK if uses >= LASTING_USES else SMALL_BANK)

    def _bank_bytes(self, n: int, offset: float) -> int:
        """Bytes that the patches take at most, as float32."""
        from sppm_pipeline.method.assembly.patches import predicted_bytes

        pieces, (tables, key) = self.tileset.micro.pieces, self._table(n, offset, "bytes")
        if key not in tables:
            tables[key] = predicted_bytes(pieces, n, self.tileset.combinations(), offset=offset, cutoff=CUTOFF)
        return int(tables[key])

    def _table(self, n: int, offset: float, what: object) -> tuple[dict[Any, Any], object]:
        """Table and key under which something about the patches is kept."""
        key = (self.tileset.kind, self.tileset.palette_colors, n, offset, what)
        return sampling_tables(self.tileset.micro.pieces), key

    def patches(self, n: int, offset: float, threads: int = 1, solid: bool = False) -> Patches | None:
        from sppm_pipeline.method.assembly.patches import build_bank

        if not self.has_patches(n, offset):
            return None
        # what takes much memory is kept in sixteen bits, where only solid and void are distinguished
        level = self.solid_below if solid and self._bank_bytes(n, offset) > SMALL_BANK else None
        tables, key = self._table(n, offset, level)
        if key not in tables:
            if level is not None:  # patches of sixteen bits belong to a level: those of one at a time
                for other in [k for k in tables if isinstance(k, tuple) and isinstance(k[-1], float)]:
                    del tables[other]
            pieces, combinations = self.tileset.micro.pieces, self.tileset.combinations()
            tables[key] = build_bank(
                pieces, n, combinations, offset=offset, cutoff=CUTOFF, threads=threads, solid_level=level
            )
        return Patches(tables[key], self.arrays)

    def summary(self) -> dict[str, Any]:
        """Size of the lattice and number of filled cells, without those around the part."""
        filled = self.arrays.surrounded().interior
        filled = filled[filled >= 0]
        return {
            "lattice": list(self.cells),
            "filled_cells": filled.size,
            "cell_mm": self.edge,
            "interiors_used": len(distinct(filled)),
        }
