"""``tile.even_interiors``: every interior equally often, and never the same one side by side."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_even_tiles.dealing import alike_pairs, deal
from sppm_pipeline import Context, SurfaceMesh, Tiler, TileSet, Tiling


@dataclass(frozen=True, kw_only=True)
class EvenInteriors(Tiler):
    """Deal the interiors to the cells like cards: none is used more than once more often than another.

    Cells with the same interior do not touch across a face, an edge or a corner; if there are too few interiors for
    that, they touch across corners rather than edges, and edges rather than faces, and the run record says how often.
    From 27 interiors on such a layout exists for parts of any shape, as a cell has 26 neighbors (Hajnal and
    Szemeredi 1970). Face colors are drawn as by the built-in rule for the kind of tile set.
    """

    name: ClassVar[str] = "tile.even_interiors"
    kinds: ClassVar[tuple[str, ...]] = ("free", "corner")

    def lay(
        self, rng: np.random.Generator, mask: NDArray[np.bool_], tileset: TileSet
    ) -> tuple[NDArray[np.int32], tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]]:
        """Deal the interiors; any face colors go with them."""
        from sppm_pipeline.numerics import tile_corners, tile_hashed

        seed, colors, interiors = int(rng.integers(2**62)), tileset.palette_colors, tileset.micro.interiors
        if tileset.kind == "corner":
            _, faces = tile_corners(mask, seed, colors, interiors, periodic=self.periodic)
        else:
            _, faces = tile_hashed(mask, seed, interiors, colors, periodic=self.periodic)
        return deal(rng, mask, interiors), faces

    def run(self, context: Context, tileset: TileSet, cover: SurfaceMesh | None) -> Tiling:
        """Lay the cells, and count what the rule promises."""
        tiling = super().run(context, tileset, cover)
        interior = tiling.arrays.interior
        uses = np.bincount(interior[interior >= 0], minlength=tileset.micro.interiors)
        alike = alike_pairs(interior)
        context.report(
            min_uses=int(uses.min()),
            max_uses=int(uses.max()),
            alike_across_faces=alike.face,
            alike_across_edges=alike.edge,
            alike_across_corners=alike.corner,
        )
        if any(alike):
            context.warn(
                f"{sum(alike)} pairs of touching cells have the same interior; "
                f"{tileset.micro.interiors} interiors are too few to avoid it here, 27 suffice for any part"
            )
        return tiling
