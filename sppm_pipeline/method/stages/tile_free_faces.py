"""``tile.free_faces``: colors and interiors by a hash of the place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Tiler, TileSet


@dataclass(frozen=True, kw_only=True)
class FreeFacesTiling(Tiler):
    """Draw every interior and every face color by a fixed integer hash of its place: any cell is known at once."""

    name: ClassVar[str] = "tile.free_faces"
    kinds: ClassVar[tuple[str, ...]] = ("free",)

    def lay(
        self, rng: np.random.Generator, mask: NDArray[np.bool_], tileset: TileSet
    ) -> tuple[NDArray[np.int32], tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]]:
        from sppm_pipeline.method.tiling.hashed import tile_hashed

        seed = int(rng.integers(2**62))
        return tile_hashed(mask, seed, tileset.micro.interiors, tileset.palette_colors, periodic=self.periodic)
