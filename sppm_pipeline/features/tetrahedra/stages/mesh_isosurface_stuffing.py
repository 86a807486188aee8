"""``mesh.isosurface_stuffing``: tetrahedra that fill the solid of a field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, DesignError, Palette, Part, ScalarField, Size, Stage, option, options
from sppm_pipeline.features.tetrahedra.volume_mesh import VolumeMesh
from sppm_pipeline.services.grid import Grid

Sampled = NDArray[np.float32]


@dataclass(frozen=True, kw_only=True)
class IsosurfaceStuffing(Stage):
    """Fill the solid with tetrahedra whose dihedral angles lie between 10.7 and 164.8 degrees.

    The box of a cell or tiling is kept: solid that reaches its faces ends there in a plane. Nodes on opposite faces
    of a periodic box are copies of each other. Edges of the mesh inside the solid are as long as a cube of the grid,
    or 0.87 of it; what is thinner is lost, and sharp edges of a part are rounded.
    """

    name: ClassVar[str] = "mesh.isosurface_stuffing"
    reported: ClassVar[tuple[str, ...]] = (
        "removed_share", "put_back", "minimum_dihedral_degrees", "maximum_dihedral_degrees", "maximum_radius_ratio",
    )  # fmt: skip

    resolution: int = options.resolution(32, note="here cubes of a lattice", minimum=4, maximum=512)
    islands: str = options.islands("auto", note="that is, solid that shares no face with the rest")
    order: int = option(
        1, help="1: straight tetrahedra; 2: quadratic, with a node in the middle of each edge", minimum=1, maximum=2
    )

    def estimate(self, palette: Palette, field: Size) -> Size:
        from sppm_pipeline.features.tetrahedra.numerics.stuffing import expected_counts

        body, grid, n = field.body, field.grid(self.resolution), self.resolution
        tetrahedra, nodes, triangles = expected_counts(body.surface, body.volume, body.porosity, n)
        return Size(
            samples=2 * grid.samples, sums=2 * grid.sums, resident=grid.samples, tetrahedra=tetrahedra, nodes=nodes,
            mid_nodes=nodes + tetrahedra + triangles / 2 if self.order == 2 else 0.0,
            triangles=triangles, geometry=body,
        )  # fmt: skip

    def run(self, context: Context, field: ScalarField) -> VolumeMesh:
        """Sample the lattice and cut it; the mesh is in mm (cell sizes for a cell without a size)."""
        from sppm_pipeline.features.tetrahedra.numerics.lattice import doubled_grid
        from sppm_pipeline.features.tetrahedra.numerics.quadratic import with_mid_nodes
        from sppm_pipeline.features.tetrahedra.numerics.quality import quality
        from sppm_pipeline.features.tetrahedra.numerics.stuffing import require_room, stuff, without_islands
        from sppm_pipeline.method.connectivity.removal import report_removal

        n, h = self.resolution, 1.0 / self.resolution
        if (coarse := field.coarseness(h)) is not None:
            context.warn(coarse)
        if field.edge_mm is None:
            context.warn("the cell has no physical size: one cell size is written as 1 mm")
        low, high = np.zeros(3, np.int64), np.array(field.cells) * n
        if isinstance(field, Part):
            edge = field.physical_edge()
            low = np.floor((field.domain.lower - field.origin_mm) / edge * n).astype(np.int64) - 1
            high = np.ceil((field.domain.upper - field.origin_mm) / edge * n).astype(np.int64) + 1
        nx, ny, nz = (int(v) for v in high - low)
        require_room(nx, ny, nz)
        sampled = _sampled(field, low, (nx, ny, nz), h, context.threads)
        grids = [doubled_grid(*one, field.periodic) for one in sampled]
        values = grids[0] if len(grids) == 1 else np.maximum(*grids)
        if not (values < 0).any():
            raise DesignError("there is no solid to mesh", hint="lower the porosity or the level, or refine the grid")
        made = stuff(values, field.periodic, tuple(grids) if len(grids) > 1 else ())
        if not len(made.tets):
            raise DesignError("the solid is too thin for this grid: nothing is left of it", hint="refine the grid")
        removed = 0.0
        if self.islands != "keep":
            made, removed = without_islands(made)
        report_removal(context, removed, self.islands, "a finer grid")
        context.report(put_back=made.put_back)
        scale, origin = field.edge_mm or 1.0, np.array(field.origin_mm)
        nodes, box = ((low + v) * h * scale + origin for v in (made.nodes, np.array([[0, 0, 0], [nx, ny, nz]])))
        shape = quality(nodes, made.tets)
        context.report(
            minimum_dihedral_degrees=shape.minimum_dihedral,
            maximum_dihedral_degrees=shape.maximum_dihedral,
            maximum_radius_ratio=shape.radius_ratio,
        )
        tets = made.tets
        if self.order == 2:
            nodes, tets = with_mid_nodes(nodes, tets)
        is_part = isinstance(field, Part)
        return VolumeMesh(nodes, tets, None if is_part else box, field.periodic, name="tetrahedra")


def _sampled(
    field: ScalarField, low: NDArray[np.int64], shape: tuple[int, int, int], h: float, threads: int
) -> list[tuple[Sampled, Sampled, tuple[Sampled, Sampled, Sampled]]]:
    """The field, or both fields of a part, at the corners and centers of cubes, and at centers of squares in faces."""
    cells = np.array(shape)
    apart = field.apart_zyx if isinstance(field, Part) else lambda grid, threads: (field.sample(grid, threads).T,)

    def at(offset: NDArray[np.float64], count: NDArray[np.int64]) -> tuple[Sampled, ...]:
        x, y, z = ((low + offset) * h).tolist()
        nx, ny, nz = count.tolist()
        return apart(Grid((x, y, z), (h, h, h), (nx, ny, nz)), threads)

    corners, centers = at(np.zeros(3), cells + 1), at(np.full(3, 0.5), cells)
    faces: list[list[Sampled]] = [[] for _ in corners]
    for axis in range(3):
        sides = []
        for side in (0, shape[axis]):
            offset, count = np.full(3, 0.5), cells.copy()
            offset[axis], count[axis] = side, 1
            # no solid reaches the box around a part
            void = (np.ones(count[::-1], np.float32),) * len(corners)
            sides.append(void if isinstance(field, Part) else at(offset, count))
        for one, low_side, high_side in zip(faces, *sides, strict=True):
            one.append(np.concatenate([low_side, high_side], axis=2 - axis))
    return [(c, m, (f[0], f[1], f[2])) for c, m, f in zip(corners, centers, faces, strict=True)]
