"""``extract.manifold_sdf``: a triangle mesh of a field, by manifold3d."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, Part, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.engine.process.budget import child_memory, require_memory
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.surface.field_surface import (
    MAX_VOXELS,
    MIN_VOXELS,
    FieldSurface,
    expected_voxels,
    on_torus,
    voxels_along_edge,
)
from sppm_pipeline.features.surface.solids import (
    ManifoldLimits,
    check_solid,
    lattice_bytes,
    lattice_samples,
    manifold_combine,
    manifold_extract,
)
from sppm_pipeline.method.part.part import node_grid
from sppm_pipeline.services.arrays import F32, F64, I32
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.stage import Context, Stage, option

Mesh = tuple[F64, I32]

TRIANGLES_RATIO = 1.75
"""Triangles over those of marching cubes at as many edges along an edge of the cell."""


@dataclass(frozen=True, kw_only=True)
class ManifoldSdf(Stage):
    """Extract the boundary of the solid by manifold3d: marching tetrahedra, with short edges collapsed.

    Fewer slivers than marching cubes leaves, for a hundred times the time. Cells and tilings are capped at the border
    of their box, though the nodes on opposite faces do not match. A part's surface is cut by the mesh of its domain, so
    that sharp edges are exact; that mesh has to be closed.
    """

    name: ClassVar[str] = "extract.manifold_sdf"
    libraries: ClassVar[tuple[str, ...]] = ("manifold3d",)
    advice: ClassVar[str] = "lower `resolution`, or use `extract.marching_cubes`"

    resolution: int | None = options.resolution(
        None, note="here cubes of a lattice; 32 if `voxel` is not given either", minimum=MIN_VOXELS, maximum=MAX_VOXELS
    )
    voxel: Length | None = options.voxel(
        None,
        note="here a cube of a lattice, at most this long, instead of `resolution`; the cell is cut into equal parts",
        formerly="spacing",
    )
    surface_tolerance: Length | None = option(
        None,
        help="how near vertices are brought to the zero of the interpolated field; without it they lie where it is "
        "between two lattice points by linear interpolation",
        unit="mm",
        above=0,
        maximum=1e6,
        formerly="tolerance",
    )
    islands: str = options.islands("auto")
    time_limit: float = options.time_limit(600.0, note="there is one for every surface and every cut")

    def check_options(self) -> None:
        if self.resolution is not None and self.voxel is not None:
            raise ConfigError("`resolution` and `voxel` exclude each other")

    def estimate(self, palette: Palette, field: Size) -> Size:
        n = expected_voxels(field.body.edge_mm, self.resolution, self.voxel)
        return field.grid(n, triangles=TRIANGLES_RATIO * field.body.triangles(n))

    def run(self, context: Context, field: ScalarField) -> SurfaceMesh:
        """Sample a grid of half the spacing, extract, cut, check; in mm (cell sizes for a cell without a size)."""
        part = field if isinstance(field, Part) else None
        if part is not None:
            check_solid(part.domain.vertices, part.domain.faces, part.domain.name)
        n = voxels_along_edge(field, self.resolution, self.voxel)
        if (coarse := field.coarseness(1 / n)) is not None:
            context.warn(coarse)
        scale = field.edge_mm if field.edge_mm is not None else 1.0
        grid = node_grid(field, n)
        _check_memory(grid, n, context.memory_limit)
        made = self._level_set(context, self._samples(context, field, grid), field, grid)
        context.report(resolution=n, voxel=scale / n)
        if part is not None:
            made = self._cut(context, made, part, grid)
        if not on_torus(field):
            made = self._without_islands(context, made)
        if field.edge_mm is None:
            context.warn("the cell has no physical size: one cell size is written as 1 mm")
        return SurfaceMesh(*made, name="surface")

    def _level_set(self, context: Context, samples: F32, field: ScalarField, grid: Grid) -> Mesh:
        """The surface of one field, placed in the world and checked."""
        if not (samples < 0).any():
            raise DesignError("there is no solid to mesh", hint="lower the porosity or the level")
        scale = field.edge_mm if field.edge_mm is not None else 1.0
        tolerance = self.surface_tolerance.mm() / scale if self.surface_tolerance is not None else None
        (vertices, faces), status = manifold_extract(
            samples, grid.origin, grid.spacing[0], tolerance, self._limits(context)
        )
        if status != "NoError" or not len(faces):
            raise DesignError(f"manifold3d made no surface: {len(faces)} triangles, status {status}")
        vertices = vertices * scale + np.array(field.origin_mm)
        check_solid(vertices, faces, "the extracted surface")
        context.report(samples=lattice_samples(grid), status=status)
        return vertices, faces

    def _cut(self, context: Context, made: Mesh, part: Part, grid: Grid) -> Mesh:
        """The domain of a part, less the voids in its core: what is within the domain but not within the skin."""
        domain = (part.domain.vertices, part.domain.faces)
        names = ("the microstructure", part.domain.name)
        if part.has_skin:
            half = _half(grid)
            _, skin, _ = part.fields_zyx(half, context.threads)
            if skin is None or not (skin > 0).any():
                return domain  # the skin is thicker than the part
            core = self._level_set(context, -skin, part, grid)
            core_names = ("the part without its skin", names[0])
            made = manifold_combine(core, made, "difference", core_names, self._limits(context)).mesh
            made = manifold_combine(domain, made, "difference", (names[1], "its void"), self._limits(context)).mesh
        else:
            made = manifold_combine(made, domain, "intersection", names, self._limits(context)).mesh
        return made

    def _limits(self, context: Context) -> ManifoldLimits:
        return ManifoldLimits(self.time_limit, child_memory(context.memory_limit))

    def _without_islands(self, context: Context, made: Mesh) -> Mesh:
        from sppm_pipeline.features.surface.numerics.meshcheck.bodies import find_shells, largest_body
        from sppm_pipeline.method.connectivity.removal import report_removal

        shells = find_shells(*made)
        context.report(bodies=shells.bodies, cavities=shells.cavities)
        if self.islands == "keep":
            return made
        kept = largest_body(*made, shells)
        alone = find_shells(*kept)
        context.report(pieces=alone.bodies)
        removed = 1 - float(alone.volumes.sum() / shells.volumes.sum())
        report_removal(context, removed, self.islands)
        return kept

    def _samples(self, context: Context, field: ScalarField, grid: Grid) -> F32:
        """The field on the grid of half the spacing; of a part without its domain, which a Boolean adds."""
        half = _half(grid)
        if not on_torus(field):
            # disconnected solid is known when the surface is there
            return (field.base if isinstance(field, Part) else field).sample(half, context.threads).T
        surface = FieldSurface(field, half, self.islands)
        slabs = surface.slabs(context.threads)
        context.report(**slabs.findings)
        return np.concatenate([slab.values for slab in slabs])


def _half(grid: Grid) -> Grid:
    """The grid of half the spacing over the same box."""
    (h, _, _), (nx, ny, nz) = grid.spacing, grid.shape
    return Grid(grid.origin, (h / 2,) * 3, (2 * nx - 1, 2 * ny - 1, 2 * nz - 1))


def _check_memory(grid: Grid, n: int, limit: int | None) -> None:
    nx, ny, nz = grid.shape
    require_memory(
        lattice_bytes(grid) + 40 * nx * ny * nz,
        f"a lattice of {nx} x {ny} x {nz} cubes",
        f"lower `resolution` (now {n}), or use `extract.marching_cubes`, which goes through the field in slabs",
        limit=limit,
    )
