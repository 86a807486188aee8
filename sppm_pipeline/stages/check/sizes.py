"""``check.sizes``: local thickness of pores and struts, and specific surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.data.length import Length
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.voxels import Voxels
from sppm_pipeline.errors import ConfigError, ResourceError
from sppm_pipeline.families import options
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.grid import cell_centers
from sppm_pipeline.stage import Context, Stage, option

LARGEST = 512**3
"""Most voxels; each takes 20 bytes while the balls are painted."""


@dataclass(frozen=True, kw_only=True)
class CheckSizes(Stage):
    """Measure the local thickness of solid (struts, walls) and of void (pores), and the specific surface.

    The local thickness at a point is the diameter of the largest ball that fits into the phase and covers the point
    (Hildebrand and Rüegsegger 1997); its distribution is weighted by volume. As balls sit
    on voxel centers, sizes come out too small, by three voxels at most. They are millimeters where the cell has a
    physical size, else cell sizes.

    Where a design has walls and tunnels of known sizes, such as that of `field.walls`, the thinnest wall and the width
    of the narrowest tunnel are reported as they were designed, and compared with what is `printable`.

    The specific surface is the area of the isosurface, per volume of the cell; that of an image of voxels, which has
    only stairs, is not given.
    """

    name: ClassVar[str] = "check.sizes"
    reported: ClassVar[tuple[str, ...]] = (
        "specific_surface", "voxel", "thinnest_wall", "narrowest_tunnel", "solid.mean", "solid.deviation",
        "solid.smallest", "solid.largest", "solid.quantiles.#3", "void.mean", "void.deviation", "void.smallest",
        "void.largest", "void.quantiles.#3",
    )  # fmt: skip

    resolution: int = options.resolution(64, note="of a field", minimum=8, maximum=512)
    printable: Length | None = option(
        None,
        help="smallest wall and opening that the printer makes; thinner ones of the design are warned about",
        unit="mm",
        above=0,
        maximum=1e6,
    )

    def estimate(self, palette: Palette, source: Size) -> Size:
        grid = source if source.voxels else source.grid(self.resolution)
        voxels = source.voxels or grid.samples
        # balls grow with the resolution, and so does the number of voxels that each of them covers
        along = voxels ** (1 / 3) if source.voxels else self.resolution
        return Size(samples=grid.samples, sums=grid.sums, voxels=along * voxels, resident=voxels)

    def run(self, context: Context, source: ScalarField | Voxels) -> None:
        """Paint balls into both phases."""
        if isinstance(source, Voxels):
            if len(set(source.spacing)) > 1:
                raise ConfigError(f"sizes need cubic voxels, these have edges {source.spacing}")
            solid = np.ascontiguousarray(source.solid().T).view(np.uint8)
            spacing, physical, periodic = source.spacing[0], source.physical, source.periodic
        else:
            cells = source.cells
            if np.prod(cells, dtype=float) * self.resolution**3 > LARGEST:
                raise ResourceError(
                    f"{' x '.join(map(str, cells))} cells of {self.resolution}^3 voxels are more than the limit of "
                    f"{LARGEST} voxels",
                    hint="lower `resolution`, or take fewer cells",
                )
            solid, area = _solid_and_area(source, self.resolution, context.threads)
            spacing, physical = (source.edge_mm or 1.0) / self.resolution, source.edge_mm is not None
            periodic = (source.periodic,) * 3
            context.report(specific_surface=area / (source.edge_mm or 1.0))
            self._compare(context, source)
        context.report(unit="mm" if physical else "cell size", voxel=spacing)
        for number, (name, phase) in enumerate({"solid": solid, "void": 1 - solid}.items()):
            context.report(**{name: _described(phase, periodic, spacing)})
            context.progress(number + 1, 2, "phases")

    def _compare(self, context: Context, field: ScalarField) -> None:
        """Report the thinnest wall and the narrowest tunnel of the design, and warn of those that can't be printed."""
        scale, unit = field.edge_mm or 1.0, "mm" if field.edge_mm else "cell size"
        radius = field.finest_radius
        designed = {"thinnest_wall": field.thinnest_wall, "narrowest_tunnel": radius and 2 * radius}
        found = {name: scale * size for name, size in designed.items() if size is not None}
        context.report(**found)
        if self.printable is None:
            return
        if field.edge_mm is None:
            raise ConfigError(
                "what is `printable` is a length in mm, but the cell has no physical size",
                hint="give the first sampling stage `edge: 7.5 mm`, or lay the cell with a `tile` stage and its `cell`",
            )
        if not found:
            context.warn("the design does not say how thin its walls and tunnels are; see the measured sizes")
        for name, size in found.items():
            if size < self.printable.mm():
                context.warn(
                    f"the {name.replace('_', ' ')} measures {size:.3g} {unit}, less than what is printable "
                    f"({self.printable.mm():g} mm)"
                )


def _described(phase: NDArray[np.uint8], periodic: tuple[bool, bool, bool], spacing: float) -> dict[str, Any] | None:
    from sppm_pipeline.numerics.local_thickness import local_thickness, size_distribution

    found = size_distribution(local_thickness(phase, periodic), spacing)
    return None if found is None else {**found._asdict(), "quantiles": list(found.quantiles)}


def _solid_and_area(field: ScalarField, n: int, threads: int) -> tuple[NDArray[np.uint8], float]:
    """Voxels, and the area of the surface between them in cell sizes^2, divided by the number of cells."""
    from sppm_pipeline.numerics.meshcheck.measures import surface_area
    from sppm_pipeline.numerics.surface.closing import wrapped
    from sppm_pipeline.numerics.surface.marching_cubes import marching_cubes

    values = field.sample(cell_centers(n, field.cells), threads).T
    solid = (values < 0).view(np.uint8)
    # the samples of a periodic field go once around, so that the surface across the seam counts too
    vertices, faces = marching_cubes(wrapped(values) if field.periodic else values)[:2]
    return solid, surface_area(vertices, faces) / n**2 / float(np.prod(field.cells))
