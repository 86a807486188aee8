"""``tile.hexahedra``: pores scattered in a mesh of hexahedra, so many in each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sppm_pipeline import Length, Palette, RecipeSize, Size, Tiling, options
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.grading.curved_porosity import FINER, FINEST, most_samples
from sppm_pipeline.features.grading.hexahedra_file import read_hexahedra
from sppm_pipeline.features.grading.hexahedral_cloud import RIM, HexahedralCloud
from sppm_pipeline.features.grading.rounds import trial
from sppm_pipeline.features.grading.stages.read_hexahedra import cells_of_mesh, size_of_mesh
from sppm_pipeline.method.families.tiler import TRIAL_BLOCKS
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.services.formats.element_file import check_elements
from sppm_pipeline.stage import Context, Recipe, Stage, option

NOT_FOLLOWED = ("scale", "spacing", "pore_radius", "tunnel_radius", "stretch", "stretch_across")
"""Maps that other stages follow which scatter pores."""


@dataclass(frozen=True, kw_only=True)
class HexahedralTiling(Stage):
    """Scatter pores in a mesh of hexahedra of any shape, each element a cell of the recipe, or a number of them.

    An extension of the paper. The mesh (VTU, VTK, INP or MSH, read by meshio) has to fill the part face to face; there
    may be holes, and any number of elements around an edge. Every element gets the pores of a cell, faces and interior
    together, finer where it is narrower; tunnels join them across elements, straight. Radii and spacings follow the
    cube root of its volume, or stay as they are in a cell of a given size. Beyond the mesh there are some more pores,
    and then all is solid: cut it by the surface of the mesh, which `read.hexahedra` gives.

    With a porosity, or a map of it, the number of pores of each element comes from a curve that trial boxes give, and
    pores are added and taken away at random where an element is found to be off, in rounds. Samplers of the recipe then
    need `total`.
    """

    name: ClassVar[str] = "tile.hexahedra"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = (
        "hexahedra", "volume_min_mm3", "volume_max_mm3", "error_mean", "error_rms", "error_p95", "error_max",
        "error_rms_of_rounds.#1", "cell_deviation",
    )  # fmt: skip
    advice: ClassVar[str] = "give a mesh of larger hexahedra"

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")
    parts: int = option(
        1, help="cells along each edge of a hexahedron, into which it is cut exactly", minimum=1, maximum=16
    )
    sizes: str = options.sizes(
        "cell", note="fixed ones are those in a cube of the edge `cell`, and numbers of pores go with volumes"
    )
    cell: Length | None = options.cell(None, note="with `sizes: fixed`; the recipe's `edge` if omitted")
    porosity: float | None = options.porosity(
        None, note="of each cell, reached by its number of pores; that of the recipe if omitted"
    )
    resolution: int = options.resolution(32, note="for measuring the porosity", minimum=8, maximum=256)
    rounds: int = options.rounds(
        2, note="in which pores are added and taken away, with a porosity", minimum=0, maximum=10
    )
    trials: int = options.trials(3, note="of the curve, with a porosity")

    def check_options(self) -> None:
        check_elements(self.path)
        if self.cell is not None and self.sizes == "cell":
            raise ConfigError(
                "`cell` is an edge in mm, but sizes follow the mesh", hint="leave out `cell`, or give `sizes: fixed`"
            )

    def estimate(self, palette: Palette, recipe: RecipeSize, grading: Size | None) -> Size:
        """Cells of the mesh and as many as the rim around it holds; grids as fine as the smallest cell asks for."""
        mesh, content = size_of_mesh(self.path, self.unit), recipe(palette, 0)
        least, edge, most = (one / self.parts for one in mesh.cell)
        cells = float(mesh.hexahedra * self.parts**3)
        if self.sizes == "fixed":
            fixed = self.cell.mm() if self.cell is not None else content.body.edge_mm
            if fixed is None:
                raise LookupError("the size of a cell is unknown")
            edge = most = fixed
        rim = RIM * most
        around = [(side + 2 * rim) / edge for side in mesh.box]
        # Steiner's formula for the box, with the area of the mesh
        shell = mesh.area * rim + math.pi * sum(mesh.box) * rim**2 + 4 / 3 * math.pi * rim**3
        filled = cells if self.sizes == "cell" else mesh.volume / edge**3
        drawn = filled + min(shell / edge**3, math.prod(around))
        box = (mesh.box[0] / edge, mesh.box[1] / edge, mesh.box[2] / edge)
        made = content.in_box(box, mesh.volume / edge**3, edge_mm=edge)
        counts = {"cells": drawn, "pores": drawn * content.cell.pores}
        if self.porosity is None and grading is None:
            recipe(palette, drawn)
            return made.at_porosity(None, **counts)
        times, n = 1 + self.rounds, self.resolution
        recipe(palette, drawn * times + 8 * TRIAL_BLOCKS**3 * self.trials)
        h = max(least / (FINEST * n), FINER * edge / made.body.coarse)
        nx, ny, nz = (side / h for side in mesh.box)
        counts |= {"samples": cells * float(n) ** 3 * times, "sums": nx * ny * nz * made.body.kernels * times}
        return made.at_porosity(self.porosity, **counts, resident=most_samples(nx, ny, nz))

    def run(self, context: Context, recipe: Recipe, grading: Grading | None = None) -> Tiling:
        """Read the mesh, throw the pores of its cells and around them, and join all."""
        if grading is not None:
            for name in (n for n in NOT_FOLLOWED if n in grading):
                raise ConfigError(
                    f"`{self.name}` follows the map 'porosity' and can't follow {name!r}",
                    hint="leave the map out, or grade the size of the hexahedra",
                )
            if "porosity" not in grading:
                raise ConfigError(
                    f"`{self.name}` follows the map 'porosity', and the grading has none",
                    hint="name a map `of: porosity`",
                )
            if self.porosity is not None:
                raise ConfigError(
                    "the porosity is given twice, by a map and by the option", hint="leave out `porosity`"
                )
        read = read_hexahedra(self.path)
        curved = cells_of_mesh(read, self.path, self.unit, self.parts, context)
        context.report(
            hexahedra=len(read.elements), volume_min_mm3=float(curved.volumes.min()),
            volume_max_mm3=float(curved.volumes.max()),
        )  # fmt: skip
        fixed = self._fixed(context, recipe) if self.sizes == "fixed" else None
        cloud = HexahedralCloud(recipe, curved, fixed, grading, self.porosity, self.trials, self.resolution)
        return cloud.laid(context, self.rounds)

    def _fixed(self, context: Context, recipe: Recipe) -> float:
        if self.cell is not None:
            return self.cell.mm()
        edge = trial(context, recipe, None, 1).edge_mm
        if edge is None:
            raise ConfigError("the size of a cell is missing", hint="give `cell: 5 mm`")
        return edge
