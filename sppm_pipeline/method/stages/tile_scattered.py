"""``tile.scattered``: pores scattered over the whole part, without faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Microstructure, Palette, RecipeSize, Size, SurfaceMesh, Tiling, options
from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.families.tiler import (
    HALO,
    REPORTED_CELLS,
    TRIAL_BLOCKS,
    LaidCells,
    Scattering,
    at_porosity,
    designed,
    laid_cells,
    lattice_for,
    scattered_by_maps,
    tiling_size,
    without_faces,
)
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.nouns.palette import Blocks, Maps
from sppm_pipeline.stage import Context, Recipe


@dataclass(frozen=True, kw_only=True)
class ScatteredTiling(LaidCells):
    """Scatter pores over the whole part: there are no faces, and nothing repeats.

    An extension of the paper. The lattice only says how many pores lie in each of its blocks: the recipe's number for a
    cell, faces and interior together. Pores keep their spacing and are joined across blocks. Samplers that need the
    whole cell are refused.

    With maps of `porosity`, `scale` or `pore_radius` density and spacing follow them: the number of pores comes from a
    curve that trial boxes give, and pores are then added and taken away at random where a block is found to be off, in
    rounds. Sizes at a scale s are s times those of the recipe. The recipe's samplers then need `total`. A map of
    `spacing` changes the distance of pores alone. With maps of `stretch` s and of a direction pores are s times as long
    along it as across, where their radii are those of the recipe, and 1/s as many; `stretch_across` is a second
    stretch, perpendicular to the first. A box of pores that are stretched alike everywhere may be `periodic`.
    """

    name: ClassVar[str] = "tile.scattered"
    version: ClassVar[int] = 3
    advice: ClassVar[str] = "give larger cells, or use `tileset.free_faces` with many interiors"

    rounds: int = options.rounds(2, note="in which pores are added and taken away, with maps", minimum=0, maximum=10)
    trials: int = options.trials(3, note="of the curve, with maps")

    def estimate(
        self, palette: Palette, recipe: RecipeSize, cover: Size | None, grading: Size | None, design: Size | None = None
    ) -> Size:
        self = designed(self, None if design is None else design.body)
        made = tiling_size(self.cell, self.cells, cover, recipe(palette, 0))
        blocks = laid_cells(made, self.periodic)
        if grading is None:
            recipe(palette, blocks)
            return self.drawn_size(made, blocks)
        # drawn and measured in rounds, the last one but one closely, as are some cells in the end
        recipe(palette, blocks * (1 + self.rounds) + 8 * TRIAL_BLOCKS**3 * self.trials)
        measured = made.cells * (1 + (self.rounds - 1) / 8) + min(made.cells, REPORTED_CELLS)
        return self.drawn_size(made, blocks, float(self.resolution) ** 3 * measured)

    def run(
        self, context: Context, recipe: Recipe, cover: SurfaceMesh | None, grading: Maps | None = None,
        design: CellSizes | None = None,
    ) -> Tiling:  # fmt: skip
        """Throw and join the pores of all blocks of the part, and of those around it."""
        self = designed(self, design)
        from sppm_pipeline.method.tiling.lattice import with_halo

        lattice = lattice_for(self.cell, self.cells, cover, None)
        halo = 0 if self.periodic else HALO
        blocks = Blocks(with_halo(lattice.mask, halo), self.periodic)
        wanted = Scattering(
            recipe, lattice, blocks.mask, cover, self.periodic, self.porosity, self.resolution, self.rounds, self.trials
        )
        followed = scattered_by_maps(context, grading, wanted)
        if followed is not None:
            check_reach(followed.tileset.micro)
            return followed
        palette = Palette(int(blocks.mask.sum()), (0, 0, 0), blocks=blocks)
        micro = self.drawn(context, recipe, palette, "scattered")
        check_reach(micro)
        edge = lattice.edge if lattice.edge is not None else micro.edge_mm
        tiling = without_faces(micro, blocks, halo, edge, lattice.origin)
        return tiling if self.porosity is None else at_porosity(context, tiling, cover, self.porosity, self.resolution)


def check_reach(micro: Microstructure) -> None:
    """Raise `DesignError` if kernels are felt beyond the next cell."""
    if micro.reach > HALO:
        raise DesignError(
            f"the kernels reach {micro.reach:.3g} cell sizes, but only the next cell is looked at",
            hint="give larger cells with more pores, or smaller radii",
        )
