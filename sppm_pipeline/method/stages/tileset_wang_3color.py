"""``tileset.wang_3color``: the paper's tile set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Palette, TileSetMaker, options
from sppm_pipeline.method.assembly.contents import TilingArrays, lone_periodic_cell


@dataclass(frozen=True, kw_only=True)
class WangTileSet(TileSetMaker):
    """The c^3 tiles with equal colors on opposite faces, 27 for three colors (paper, "Overall Stochasticity").

    Every tile has an interior of its own. A tile may be used alone as a periodic cell.
    """

    name: ClassVar[str] = "tileset.wang_3color"
    kind: ClassVar[str] = "wang"

    colors: int = options.colors(3, note="of faces", maximum=8)

    def palette_size(self) -> int:
        return self.colors

    def palette(self) -> Palette:
        c = self.colors
        tile = np.arange(c**3)
        own = np.stack([tile // c**2, tile // c % c, tile % c], 1)
        meetings = [
            np.stack([tile, np.full_like(tile, axis), np.full_like(tile, side), own[:, axis]], 1)
            for axis in range(3)
            for side in range(2)
        ]
        return Palette(c**3, (c, c, c), np.concatenate(meetings))

    def trial(self) -> list[TilingArrays]:
        """Each tile among copies of itself."""
        c = self.colors
        return [lone_periodic_cell(t, (t // c**2, t // c % c, t % c)) for t in range(c**3)]
