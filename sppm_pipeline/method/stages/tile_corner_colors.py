"""``tile.corner_colors``: corner colors by a hash of the place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Tiler, TileSet
from sppm_pipeline.services.arrays import I32, Bools


@dataclass(frozen=True, kw_only=True)
class CornerColorsTiling(Tiler):
    """Draw the color of every lattice corner by a hash of its place; faces follow from their four corners."""

    name: ClassVar[str] = "tile.corner_colors"
    kinds: ClassVar[tuple[str, ...]] = ("corner",)

    def lay(self, rng: np.random.Generator, mask: Bools, tileset: TileSet) -> tuple[I32, tuple[I32, I32, I32]]:
        from sppm_pipeline.method.tiling.corners import tile_corners

        seed = int(rng.integers(2**62))
        return tile_corners(mask, seed, tileset.palette_colors, tileset.micro.interiors, periodic=self.periodic)
