"""``tile.fresh``: no cell and no face is used twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Palette, RecipeSize, Size, SurfaceMesh, TileSet, Tiling
from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.tiler import (
    HALO,
    LaidCells,
    at_porosity,
    designed,
    laid_cells,
    lattice_for,
    tiling_size,
)
from sppm_pipeline.method.families.tileset_maker import check_faces
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.stage import Context, Recipe, option


@dataclass(frozen=True, kw_only=True)
class FreshTiling(LaidCells):
    """Draw new interiors and faces for every cell of the part: nothing repeats, at the price of drawing every cell.

    An extension of the paper. Cells of 68 pores take 20 kB each; fields are summed from the kernels, as caching
    patches that are used once would gain nothing.
    """

    name: ClassVar[str] = "tile.fresh"
    version: ClassVar[int] = 2
    advice: ClassVar[str] = "give larger cells, or use `tileset.free_faces` with many interiors"

    limit: int = option(100_000, help="maximum number of cells that are drawn", minimum=1, maximum=1_000_000)

    def estimate(self, palette: Palette, recipe: RecipeSize, cover: Size | None, design: Size | None = None) -> Size:
        self = designed(self, None if design is None else design.body)
        made = tiling_size(self.cell, self.cells, cover, recipe(palette, 0))
        cells = laid_cells(made, self.periodic)
        recipe(palette, cells)
        return self.drawn_size(made, cells)

    def run(
        self, context: Context, recipe: Recipe, cover: SurfaceMesh | None, design: CellSizes | None = None
    ) -> Tiling:
        """Number the cells and faces, then draw them all."""
        self = designed(self, design)
        from sppm_pipeline.method.tiling.lattice import meetings, tile_fresh, with_halo

        lattice = lattice_for(self.cell, self.cells, cover, None)
        halo = 0 if self.periodic else HALO
        mask = with_halo(lattice.mask, halo)
        wanted = int(mask.sum())
        if wanted > self.limit:
            raise DesignError(
                f"the part takes {wanted} cells{', with those around it' if halo else ''}, and each would be drawn "
                f"separately; the limit is {self.limit}",
                hint=f"give larger cells, raise `limit: {wanted}`, or use `tileset.free_faces` with many interiors",
            )
        interior, faces = tile_fresh(mask, periodic=self.periodic)
        colors = tuple(int(f.max()) + 1 for f in faces)
        palette = Palette(wanted, (colors[0], colors[1], colors[2]), meetings(interior, faces))
        micro = self.drawn(context, recipe, palette, "fresh")
        check_faces(micro, palette, recipe.name)
        edge = lattice.edge if lattice.edge is not None else micro.edge_mm
        arrays = TilingArrays(interior, faces, self.periodic, halo)
        tiling = Tiling(TileSet(micro, "fresh", 0), arrays, edge, lattice.origin)
        return tiling if self.porosity is None else at_porosity(context, tiling, cover, self.porosity, self.resolution)
