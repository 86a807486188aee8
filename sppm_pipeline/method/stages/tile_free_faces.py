"""``tile.free_faces``: colors and interiors by a hash of the place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Tiler, TileSet
from sppm_pipeline.services.arrays import I32, Bools


@dataclass(frozen=True, kw_only=True)
class FreeFacesTiling(Tiler):
    """Draw every interior and every face color by a fixed integer hash of its place: any cell is known at once."""

    name: ClassVar[str] = "tile.free_faces"
    kinds: ClassVar[tuple[str, ...]] = ("free",)

    def lay(self, rng: np.random.Generator, mask: Bools, tileset: TileSet) -> tuple[I32, tuple[I32, I32, I32]]:
        from sppm_pipeline.method.tiling.hashed import tile_hashed

        seed = int(rng.integers(2**62))
        return tile_hashed(mask, seed, tileset.micro.interiors, tileset.palette_colors, periodic=self.periodic)
