"""``tile.wang_3color``: the paper's Rule 1 and Rule 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Tiler, TileSet, option
from sppm_pipeline.services.arrays import I32, Bools


@dataclass(frozen=True, kw_only=True)
class WangTiling(Tiler):
    """Lay tiles so that touching faces agree (Rule 1) and neighbors differ as much as they can (Rule 2).

    Cells are filled in raster order. Ties of Rule 2 are broken at random, from the run's seed.
    """

    name: ClassVar[str] = "tile.wang_3color"
    kinds: ClassVar[tuple[str, ...]] = ("wang",)

    rule2: bool = option(True, help="prefer tiles that differ from their neighbors; otherwise any tile that fits")

    def lay(self, rng: np.random.Generator, mask: Bools, tileset: TileSet) -> tuple[I32, tuple[I32, I32, I32]]:
        from sppm_pipeline.method.tiling.wang import tile_wang

        return tile_wang(
            mask, int(rng.integers(2**62)), tileset.palette_colors, scored=self.rule2, periodic=self.periodic
        )
