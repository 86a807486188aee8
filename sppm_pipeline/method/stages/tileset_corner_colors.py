"""``tileset.corner_colors``: face patterns named by the colors of their corners."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Palette, TileSetMaker, options
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.tileset_maker import in_turn


@dataclass(frozen=True, kw_only=True)
class CornerColorsTileSet(TileSetMaker):
    """Corner cubes (Lagae and Dutre 2006): each lattice corner has one of c colors, each face one of c^4 patterns.

    Neighbors that only touch at an edge or corner are thereby constrained, too, and far more patterns occur than
    with colored faces. An extension of the paper.
    """

    name: ClassVar[str] = "tileset.corner_colors"
    sources: ClassVar[tuple[str, ...]] = (
        "A. Lagae, P. Dutré: An alternative for Wang tiles: colored edges versus colored corners. ACM "
        "Transactions on Graphics 25(4), 2006. https://doi.org/10.1145/1183287.1183296",
    )
    kind: ClassVar[str] = "corner"

    colors: int = options.colors(2, note="of corners", maximum=3)
    interiors: int = options.interiors(64)

    def palette_size(self) -> int:
        return self.colors

    def palette(self) -> Palette:
        return Palette(self.interiors, (self.colors**4,) * 3)

    def trial(self) -> list[TilingArrays]:
        """One periodic layout by the hash, large enough to show every interior in turn."""
        from sppm_pipeline.method.tiling.corners import tile_corners

        return in_turn(self.interiors, lambda mask: tile_corners(mask, 0, self.colors, self.interiors, periodic=True))
