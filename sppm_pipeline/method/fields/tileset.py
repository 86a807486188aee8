"""Tile sets: which interiors may meet which face colors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from sppm_pipeline.method.fields.microstructure import Microstructure
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.services.arrays import I32


@dataclass(frozen=True, eq=False)
class TileSet(Artifact):
    """A microstructure with many interiors and face colors, and the kind of rule it was drawn for.

    Attributes
    ----------
    micro : Microstructure
    kind : {"wang", "free", "corner", "fresh", "scattered"}
        "wang": interior t belongs to the tile with colors (cx, cy, cz), t = (cx c + cy) c + cz, equal on opposite
        faces (paper, section 2.2). "free": any interior meets any color on any side. "corner": face colors stand
        for the colors of the four corners of the face. "fresh": the content of one tiling, nothing twice; "scattered":
        that of one without faces.
    palette_colors : int
        c: face colors, or corner colors for "corner".
    porosity : tuple of float
        Porosity of each interior among copies of itself, as measured when the set was made; empty if not measured.
    target : float or None
        Porosity that was asked for, to which tile rules cut what they have laid; None for the recipe's own level.
    """

    micro: Microstructure
    kind: str
    palette_colors: int
    porosity: tuple[float, ...] = ()
    target: float | None = None

    def check(self) -> None:
        """Interiors for all combinations of colors where there must be, and porosities between 0 and 1."""
        self.micro.check()
        if self.kind == "wang" and self.micro.interiors != self.palette_colors**3:
            raise ValueError(
                f"a tile set of {self.palette_colors} colors has {self.palette_colors**3} interiors, one for each "
                f"combination; got {self.micro.interiors}"
            )
        if self.porosity and len(self.porosity) != self.micro.interiors:
            raise ValueError(f"{self.micro.interiors} interiors, but {len(self.porosity)} porosities")
        if not all(0 <= porosity <= 1 for porosity in self.porosity):
            raise ValueError(f"the porosity of an interior is between 0 and 1, got {self.porosity}")

    def combinations(self) -> I32 | None:
        """Rows (interior, six face colors) that may occur, or None if any interior meets any colors.

        The colors stand in the order low x, high x, low y, high y, low z, high z.
        """
        if self.kind != "wang":
            return None
        c = self.palette_colors
        tile = np.arange(c**3)
        own = (tile // c**2, tile // c % c, tile % c)
        there = self.micro.colors
        x, y, z = (k if n else np.full_like(k, -1) for k, n in zip(own, there, strict=True))
        return np.stack([tile, x, x, y, y, z, z], 1).astype(np.int32)

    def summary(self) -> dict[str, Any]:
        """Sizes, level and the spread of porosity over the tiles."""
        spread: dict[str, Any] = {}
        if self.porosity:
            mean = sum(self.porosity) / len(self.porosity)
            spread = {
                "porosity": mean,
                "tile_porosity_min": min(self.porosity),
                "tile_porosity_max": max(self.porosity),
            }
        return {**self.micro.summary(), "kind": self.kind, "palette_colors": self.palette_colors, **spread}
