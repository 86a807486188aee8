"""``tileset.free_faces``: K interiors and c colors that all combine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Palette, TileSetMaker, options
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.tileset_maker import in_turn


@dataclass(frozen=True, kw_only=True)
class FreeFacesTileSet(TileSetMaker):
    """Interiors, face patterns and connectors kept apart, so that K interiors and c colors serve K c^6 tiles.

    Opposite faces of a cell may differ, which the paper's set does not allow; this is an extension of the paper.
    """

    name: ClassVar[str] = "tileset.free_faces"
    kind: ClassVar[str] = "free"

    colors: int = options.colors(3, note="of faces, for each axis", maximum=64)
    interiors: int = options.interiors(27)

    def palette_size(self) -> int:
        return self.colors

    def palette(self) -> Palette:
        return Palette(self.interiors, (self.colors,) * 3)

    def trial(self) -> list[TilingArrays]:
        """One periodic layout by the hash, large enough to show every interior in turn."""
        from sppm_pipeline.method.tiling.hashed import tile_hashed

        return in_turn(self.interiors, lambda mask: tile_hashed(mask, 0, self.interiors, self.colors, periodic=True))
