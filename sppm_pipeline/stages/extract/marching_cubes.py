"""``extract.marching_cubes``: a triangle mesh of a field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline.data.estimate import Estimate, Given
from sppm_pipeline.data.field import ScalarField
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.part import Part
from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.grid import Grid
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class MarchingCubes(Stage):
    """Extract the boundary of the solid: closed, oriented outward, without degenerate triangles.

    Cells and tilings are capped at the border of their box. With ``backend: reference`` scikit-image's independent
    implementation is used, slower, for comparison.
    """

    name: ClassVar[str] = "extract.marching_cubes"

    resolution: int = option(32, help="voxels along a cell edge", unit="voxels", minimum=4, maximum=1024)
    islands: str = option("remove", help="what becomes of solid that hangs on nothing", choices=("remove", "keep"))
    backend: str = option("compiled", help="which implementation runs", choices=("compiled", "reference"))

    def estimate(self, given: Given) -> Estimate:
        from sppm_pipeline.numerics.forecast import costs

        facts, n = given["field"], self.resolution
        voxels = float(np.prod(facts["box"])) * n**3
        part = facts.get("is_part", False)
        inner = costs.surface_triangles(facts["surface"], n) * facts["volume"]
        triangles = inner + 2 * facts["envelope"] * (1 - facts["porosity"]) * n**2
        scale = facts["cell_mm"] or 1.0
        return Estimate(
            makes={
                "triangles": triangles,
                "size_mm": tuple(scale * v for v in facts["box"]),
                "volume_mm3": (1 - facts["porosity"]) * facts["volume"] * scale**3,
                "area_mm2": facts["surface"] * facts["volume"] * scale**2,
            },
            keeps=24 * triangles,
            memory=(24 if part else 14) * voxels + 60 * triangles,
            seconds=5e-7 * triangles + costs.field_seconds(voxels, facts["kernels"]) + 8e-9 * voxels,
            voxels=voxels,
            advice="lower `resolution`, or slice without a mesh (`slice.field`)",
        )

    def run(self, context: Context, field: ScalarField) -> SurfaceMesh:
        """Sample the nodes of a grid and extract the surface, in mm (cell edges for a cell without a size)."""
        from sppm_pipeline.numerics.connectivity.islands import keep_largest
        from sppm_pipeline.numerics.surface.closing import capped_marching_cubes
        from sppm_pipeline.numerics.surface.intersection import on_both_fields

        n, h = self.resolution, 1.0 / self.resolution
        if (coarse := field.coarseness(h)) is not None:
            context.warn(coarse)
        if isinstance(field, Part):
            edge = field.physical_edge()
            low = np.floor((field.domain.lower - field.origin_mm) / edge * n).astype(int) - 1
            high = np.ceil((field.domain.upper - field.origin_mm) / edge * n).astype(int) + 1
        else:
            low, high = np.zeros(3, int), np.array(field.cells) * n
        nx, ny, nz = (int(v) for v in high - low + 1)
        x, y, z = (float(v) * h for v in low)
        grid, apart = Grid((x, y, z), (h, h, h), (nx, ny, nz)), None
        if isinstance(field, Part):
            apart = field.sample_apart(grid, context.threads)
            values = np.maximum(*apart)
        else:
            values = field.sample(grid, context.threads)
        if self.islands == "remove":
            solid = values < 0
            if field.periodic and field.cells == (1, 1, 1):
                # on the torus, so that opposite faces of a cell stay equal; the last node of an axis is the first one
                kept = np.pad(keep_largest(np.ascontiguousarray(solid[:-1, :-1, :-1])), (0, 1), mode="wrap")
            else:
                kept = keep_largest(solid, (False, False, False))
            removed = solid & ~kept
            if removed.any():
                np.negative(values, out=values, where=removed)
            context.report(removed_share=float(removed.sum()) / max(1, int(solid.sum())))
        if not (values < 0).any():
            raise DesignError("there is no solid to mesh", hint="lower the porosity or the level")
        if self.backend == "reference":
            from sppm_pipeline.numerics.surface.reference import marching_cubes_reference

            padded = np.pad(values, 1, constant_values=1.0)
            vertices, faces = marching_cubes_reference(padded, 0.0, (x - h, y - h, z - h), (h, h, h))
        else:
            vertices, faces = capped_marching_cubes(values, 0.0, (x, y, z), (h, h, h))
        if apart is not None:
            vertices = on_both_fields(vertices, *apart, grid)
        scale = field.edge_mm if field.edge_mm is not None else 1.0
        if field.edge_mm is None:
            context.warn("the cell has no physical size: one cell edge is written as 1 mm")
        placed = np.asarray(vertices, np.float64) * scale + np.array(field.origin_mm)
        return SurfaceMesh(placed, faces, name="surface")
