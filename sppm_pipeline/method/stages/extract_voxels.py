"""``extract.voxels``: the image of a field."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Palette, ScalarField, Size, Stage, Voxels, options
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.services.formats.voxel_image import LARGEST_IMAGE
from sppm_pipeline.services.grid import Grid, cell_centers


def image_grid(resolution: int, cells: tuple[int, int, int]) -> Grid:
    """Centers of the voxels of an image; a ResourceError if they are too many."""
    grid = cell_centers(resolution, cells)
    if np.prod(grid.shape, dtype=float) > LARGEST_IMAGE:
        raise ResourceError(
            f"the image would have {' x '.join(map(str, grid.shape))} voxels; the limit is {LARGEST_IMAGE}",
            hint="lower `resolution`, or take fewer cells",
        )
    return grid


@dataclass(frozen=True, kw_only=True)
class ExtractVoxels(Stage):
    """Sample a field at voxel centers: 1 where it is solid, 0 elsewhere, over all its cells."""

    name: ClassVar[str] = "extract.voxels"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = ()

    resolution: int = options.resolution(32)
    exact: bool = options.exact(False)

    def estimate(self, palette: Palette, field: Size) -> Size:
        n, body = self.resolution, field.body
        x, y, z = (float(math.ceil(v)) for v in body.box)
        grid = replace(field, geometry=replace(body, box=(x, y, z))).grid(n)
        return replace(grid, voxels=grid.samples, outline=body.outline(1 / n, 1 / n), layers=n * z)

    def run(self, context: Context, field: ScalarField) -> Voxels:
        """Sample, one layer of cells after the other."""
        n, cells = self.resolution, field.cells
        grid = image_grid(n, cells)
        if coarse := field.coarseness(1 / n):
            context.warn(coarse)
        source = field.exactly() if self.exact else field
        solid = np.empty(grid.shape, np.uint8, order="F")
        for layer in range(cells[2]):
            first, stop = layer * n, (layer + 1) * n
            solid[:, :, first:stop] = source.solid_layers(grid, first, stop, context.threads)
            context.progress(layer + 1, cells[2], "layers of cells")
        edge = field.edge_mm
        return Voxels(solid, ((edge or 1.0) / n,) * 3, edge is not None, (field.periodic,) * 3)
