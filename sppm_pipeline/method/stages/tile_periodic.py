"""``tile.periodic``: one cell, repeated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Length, Microstructure, Palette, ScalarField, Size, SurfaceMesh, TileSet, Tiling, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.families.tiler import HALO, at_porosity, designed, lattice_for, measured_tiling, tiling_size
from sppm_pipeline.method.fields.scalar_field import RepeatedField
from sppm_pipeline.method.nouns.cell_sizes import CellSizes
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class PeriodicTiling(Stage):
    """Repeat one periodic cell, or one tile of the paper's set, through a part.

    The level is that at which the box or part has the porosity asked for, by `porosity` or by the tile set.
    """

    name: ClassVar[str] = "tile.periodic"
    version: ClassVar[int] = 2
    advice: ClassVar[str] = "give larger cells or fewer of them"

    cell: Length | None = options.cell(None, note="in the part; the recipe's `edge` if omitted")
    cells: tuple[int, int, int] | None = options.cells(None)
    porosity: float | None = options.porosity(None, note="that of the part or box; that of the source if omitted")
    resolution: int = options.resolution(32, note="for measuring the porosity", minimum=8, maximum=256)
    tile: int = option(0, help="which tile of a tile set is repeated", minimum=0, maximum=511)

    def estimate(self, palette: Palette, source: Size, cover: Size | None, design: Size | None = None) -> Size:
        self = designed(self, None if design is None else design.body)
        made = tiling_size(self.cell, self.cells, cover, source, patches=1.0)
        return made if self.porosity is None else measured_tiling(made, self.resolution)

    def run(
        self, context: Context, source: TileSet | ScalarField, cover: SurfaceMesh | None,
        design: CellSizes | None = None,
    ) -> Tiling | RepeatedField:  # fmt: skip
        """Lay the cells."""
        self = designed(self, design)
        if isinstance(source, TileSet):
            if source.kind != "wang":
                raise ConfigError("only tiles of a `tileset.wang_3color` are periodic cells")
            if self.tile >= source.micro.interiors:
                raise ConfigError(f"there is no tile {self.tile}; the set has {source.micro.interiors}")
            tileset, c = source, source.palette_colors
            interior, colors = self.tile, (self.tile // c**2, self.tile // c % c, self.tile % c)
        elif isinstance(source, Microstructure):
            tileset, interior, colors = TileSet(source, "wang", 1), 0, (0, 0, 0)
        else:
            if not source.periodic:
                raise ConfigError(f"a {type(source).__name__} does not repeat")
            if self.porosity is not None:
                raise ConfigError(
                    f"the porosity of a repeated {type(source).__name__} is that of its cell",
                    hint="leave out `porosity` or the design, and make the cell by `tune.porosity`",
                )
            lattice = lattice_for(self.cell, self.cells, cover, source.edge_mm)
            nx, ny, nz = lattice.mask.shape
            return RepeatedField(source, (nx, ny, nz), lattice.edge, lattice.origin)
        lattice = lattice_for(self.cell, self.cells, cover, tileset.micro.edge_mm)
        faces, repeats = [], self.cells is not None
        halo = 0 if repeats else HALO
        cells = tuple(n + 2 * halo for n in lattice.mask.shape)
        for axis in range(3):
            shape = list(cells)
            shape[axis] += 1
            color = colors[axis] if tileset.micro.colors[axis] else -1
            faces.append(np.full(shape, color, np.int32))
        arrays = TilingArrays(np.full(cells, interior, np.int32), (faces[0], faces[1], faces[2]), repeats, halo)
        tiling = Tiling(tileset, arrays, lattice.edge, lattice.origin)
        porosity = tileset.target if self.porosity is None else self.porosity
        if porosity is None:
            return tiling
        if self.cells is None:
            return at_porosity(context, tiling, cover, porosity, self.resolution)
        # one cell stands for all, so it can be looked at more closely
        interiors, (x, y, z) = arrays.interior[:1, :1, :1], faces
        one = TilingArrays(interiors, (x[:2, :1, :1], y[:1, :2, :1], z[:1, :1, :2]), True)
        cut = at_porosity(context, replace(tiling, arrays=one), None, porosity, 2 * self.resolution)
        return replace(tiling, tileset=cut.tileset)
