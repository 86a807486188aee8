"""``tile.my_word``: cells that touch across a face never have the same interior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import DesignError, Tiler, TileSet, tile_hashed


@dataclass(frozen=True, kw_only=True)
class Checkerboard(Tiler):
    """Draw even cells from the first half of the interiors and odd ones from the second, like fields of a chessboard.

    A box that repeats keeps the promise across its ends along axes with an even number of cells.
    """

    name: ClassVar[str] = "tile.my_word"
    kinds: ClassVar[tuple[str, ...]] = ("free",)  # of tile sets: those where any interior goes with any faces

    def lay(
        self, rng: np.random.Generator, mask: NDArray[np.bool_], tileset: TileSet
    ) -> tuple[NDArray[np.int32], tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]]:
        """Interiors of the cells of `mask` and colors of their faces, -1 where there are none."""
        interiors = tileset.micro.interiors
        if interiors < 2:
            raise DesignError("cells that differ need two interiors", hint="give the tile set `interiors: 2` or more")
        _, faces = tile_hashed(
            mask, int(rng.integers(2**62)), interiors, tileset.palette_colors, periodic=self.periodic
        )
        odd = np.indices(mask.shape).sum(axis=0) % 2 == 1
        half = interiors // 2
        drawn = np.where(odd, rng.integers(half, interiors, mask.shape), rng.integers(0, half, mask.shape))
        return np.where(mask, drawn, -1).astype(np.int32), faces
