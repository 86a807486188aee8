"""From a mesh or a field to the body of voxels that is loaded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Part, ScalarField, SurfaceMesh
from sppm_pipeline.features.parts.numerics.voxel_body import VoxelBody
from sppm_pipeline.method.part.inside import inside_layers, prepare_inside, way_for
from sppm_pipeline.method.porosity.fractions import solid_fractions
from sppm_pipeline.numerics import Grid

PARTS = 3
"""Samples along the edge of an element for the share that lies in the part: a plane in between errs by a 27th."""

MIN_SHARE = 0.1
"""Share of an element in the part below which it is left out: it would bear next to nothing, and hang loose."""


class SharedBody(NamedTuple):
    """A body, and how much of each voxel is there, (nz, ny, nx) float32."""

    body: VoxelBody
    share: NDArray[np.float32]


def fitted(
    lower: NDArray[np.float64], upper: NDArray[np.float64], edge: float
) -> tuple[tuple[int, int, int], tuple[float, float, float]]:
    """Voxels along x, y, z that fill a box, and their edges, as near to one edge as that allows."""
    extent = np.maximum(np.asarray(upper) - np.asarray(lower), 1e-9)
    nx, ny, nz = (max(1, round(side / edge)) for side in extent.tolist())
    x, y, z = (extent / (nx, ny, nz)).tolist()
    return (nx, ny, nz), (x, y, z)


def mesh_body(mesh: SurfaceMesh, edge: float) -> SharedBody:
    """Elements of about an edge, mm, that fill a mesh."""
    (nx, ny, nz), edges = fitted(mesh.lower, mesh.upper, edge)
    fine = np.array(edges) / PARTS
    x, y, z = (np.asarray(mesh.lower) + fine / 2).tolist()
    hx, hy, hz = fine.tolist()
    grid = Grid((x, y, z), (hx, hy, hz), (nx * PARTS, ny * PARTS, nz * PARTS))
    scan = prepare_inside(mesh.vertices, mesh.faces, grid, way_for(mesh.bounds_solid))
    share = np.empty((nz, ny, nx), np.float32)
    for k in range(nz):
        layer = inside_layers(scan, k * PARTS, (k + 1) * PARTS).mask
        share[k] = layer.reshape(PARTS, ny, PARTS, nx, PARTS).mean(axis=(0, 2, 4))
    share[share < MIN_SHARE] = 0
    low_x, low_y, low_z = np.asarray(mesh.lower).tolist()
    return SharedBody(VoxelBody(share > 0, edges, (low_x, low_y, low_z)), share)


def field_body(field: ScalarField, per_cell: int, threads: int, *, binary: bool) -> SharedBody:
    """The very solid of a field or part, on voxels of about a cell size over `per_cell`; shares are solid fractions."""
    cell, start = field.physical_edge(), np.array(field.origin_mm)
    if isinstance(field, Part):
        lower, upper = np.asarray(field.domain.lower), np.asarray(field.domain.upper)
    else:
        lower, upper = start, start + cell * np.array(field.cells)
    (nx, ny, nz), edges = fitted(lower, upper, cell / per_cell)
    low, unit = (lower - start) / cell, np.array(edges) / cell

    def in_cells(grid: Grid) -> Grid:
        """A grid counted in voxels, from the low corner."""
        x, y, z = (low + unit * np.array(grid.origin)).tolist()
        hx, hy, hz = (unit * np.array(grid.spacing)).tolist()
        return Grid((x, y, z), (hx, hy, hz), grid.shape)

    if binary:
        grid = in_cells(Grid((0.5,) * 3, (1.0,) * 3, (nx, ny, nz)))
        share = field.solid_zyx(grid, 0, nz, threads).astype(np.float32)
    else:
        share = solid_fractions(
            lambda grid, first, stop: field.sample_zyx(in_cells(grid), first, stop, threads), (nx, ny, nz), 1
        )
    x, y, z = lower.tolist()
    return SharedBody(VoxelBody(share > 0, edges, (x, y, z)), share)
