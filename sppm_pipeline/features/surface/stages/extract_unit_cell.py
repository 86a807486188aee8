"""``extract.unit_cell``: the mesh of one periodic cell, and the places where it is repeated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Palette, Part, ScalarField, Size, Stage, Tiling, options
from sppm_pipeline.features.surface.field_surface import KEPT_SAMPLES
from sppm_pipeline.features.surface.stages.extract_marching_cubes import MarchingCubes
from sppm_pipeline.method.fields.scalar_field import RepeatedField
from sppm_pipeline.method.nouns.mesh import RepeatedMesh
from sppm_pipeline.services.arrays import I64

_HINT = "lay one cell with `tile.periodic`, or mesh the whole with `extract.marching_cubes`"


@dataclass(frozen=True, kw_only=True)
class UnitCell(Stage):
    """Extract the surface of one cell of a periodic lattice, capped at the faces of the cell, and where it is repeated.

    The lattice is what `tile.periodic` lays. `write.mesh` makes one object of all copies, or, where the format knows
    copies (GLB, 3MF on request), writes the mesh of one cell and places it as often as there are cells: files are
    smaller by that number. Copies touch with their caps; slicing programs unite solids that touch, a surface without
    walls inside is made by `extract.marching_cubes`.
    """

    name: ClassVar[str] = "extract.unit_cell"
    version: ClassVar[int] = 3

    resolution: int = options.resolution(32, minimum=4)
    islands: str = options.islands("auto")

    def estimate(self, palette: Palette, field: Size) -> Size:
        one, n = field.in_box((1.0, 1.0, 1.0)), self.resolution
        return one.grid(n, at_once=KEPT_SAMPLES, triangles=one.body.triangles(n), copies=max(1.0, field.body.volume))

    def run(self, context: Context, field: ScalarField) -> RepeatedMesh:
        """Extract one cell, in mm, and list the cells."""
        unit, cells = _unit_and_cells(field)
        alone = RepeatedField(unit, (1, 1, 1), field.edge_mm, field.origin_mm)
        mesh = MarchingCubes(resolution=self.resolution, islands=self.islands).run(context, alone)
        edge = field.edge_mm if field.edge_mm is not None else 1.0
        return RepeatedMesh(mesh, cells * np.float64(edge))


def _unit_and_cells(field: ScalarField) -> tuple[ScalarField, I64]:
    """The periodic cell, and the indices (k, 3) of the cells of the lattice; DesignError if the cells differ."""
    if isinstance(field, Tiling):
        interior, planes, *_ = field.arrays.surrounded()
        cells = np.argwhere(interior >= 0)
        kinds = np.unique(interior[interior >= 0])
        # of each axis, the colors on both sides of the cells that are there
        colors = [
            np.unique(np.concatenate([plane[tuple(cells.T)], plane[tuple((cells + np.eye(3, dtype=int)[axis]).T)]]))
            for axis, plane in enumerate(planes)
        ]
        if len(kinds) != 1 or any(len(found) != 1 for found in colors):
            raise DesignError(f"{len(kinds)} different cells cannot be copies of one", hint=_HINT)
        x, y, z = (max(0, int(found[0])) for found in colors)
        return field.tileset.micro.alone(int(kinds[0]), (x, y, z)), cells
    if isinstance(field, Part) or not field.periodic:
        raise DesignError(f"a {type(field).__name__} has no cell that is repeated", hint=_HINT)
    if isinstance(field, RepeatedField):
        if field.base.cells != (1, 1, 1):
            raise DesignError(f"the lattice repeats {field.base.cells} cells at once", hint=_HINT)
        return field.base, np.argwhere(np.ones(field.extent, bool))
    if field.cells != (1, 1, 1):
        raise DesignError(f"a {type(field).__name__} of {field.cells} cells is not the repetition of one", hint=_HINT)
    return field, np.zeros((1, 3), np.int64)
