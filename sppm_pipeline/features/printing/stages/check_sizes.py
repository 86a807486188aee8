"""``check.sizes``: local thickness of pores and struts, and specific surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, ScalarField, Size, Voxels, options
from sppm_pipeline.errors import ConfigError, ResourceError
from sppm_pipeline.features.printing.print_report import Measure, parse_rule
from sppm_pipeline.services.arrays import F32, U8
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.stage import Context, Headline, Rejected, Stage, option

MEASURES = {
    "thin": Measure("thin_solid_share", "", "share of the solid that is thinner than the machine makes it"),
    "narrow": Measure("narrow_void_share", "", "share of the void that is narrower than the machine leaves open"),
}
"""Names that `fail` accepts."""

WARNED_FRACTION = 0.01
"""Fraction that triggers a warning, a heuristic: rims of walls that are thick enough make up as much, so that at half
of it sound parts trigger one."""

MIN_VOXELS_ACROSS = 6
"""Voxels that a limit should measure: twice the error of the sizes."""

PEOPLE = {"solid": "strut", "void": "pore"}
"""Entry of the summary for the sizes of a phase in the limit of fine grids."""

MAX_VOXELS = 512**3
"""Most voxels; each takes 20 bytes while the balls are painted."""


@dataclass(frozen=True, kw_only=True)
class CheckSizes(Stage):
    """Measure the local thickness of solid (struts, walls) and of void (pores), and the specific surface.

    The local thickness at a point is the diameter of the largest ball that fits into the phase and covers the point
    (Hildebrand and Rüegsegger 1997); its distribution is weighted by volume. As balls sit
    on voxel centers, `solid` and `void` come out too small, by three voxels at most. Of a field, `strut` and `pore` are
    the sizes in the limit of fine grids, from a second grid that is half as fine, with the quantiles at 5 and 95 % and
    at 1 % (`thinnest`). Sizes are millimeters where the cell has a physical size, else cell sizes.

    Where a design has walls and tunnels of known sizes, such as that of `field.walls`, the thinnest wall and the width
    of the narrowest tunnel are reported as they were designed, and compared with what is `printable`.

    What the machine makes is said by `printable`, by the `nozzle` that extrudes filament, or by the limits of a
    `powder` process: then the share of the solid that is thinner is reported and warned about, and that of the void
    that is narrower. As sizes come out too small, the shares come out too large, most so for limits of less than six
    voxels, which are warned about. With `fail`, a design that breaks a rule is rejected (exit code 3). That a strut is
    thick enough does not make it printable: bridges, overhang and warping are for your slicer to see.

    The specific surface is the area of the isosurface, per volume of the cell; that of an image of voxels, which has
    only stairs, is not given.
    """

    name: ClassVar[str] = "check.sizes"
    sources: ClassVar[tuple[str, ...]] = (
        "T. Hildebrand, P. Rüegsegger: A new method for the model-independent assessment of thickness in "
        "three-dimensional images. Journal of Microscopy 185, 1997. "
        "https://doi.org/10.1046/j.1365-2818.1997.1340694.x",
    )
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("strut.mean", "struts", "{unit}", "strut.deviation"), Headline("strut.between", "5-95 %"),
        Headline("pore.mean", "pores", "{unit}", "pore.deviation"), Headline("pore.between", "5-95 %"),
        Headline("surface_cm2_per_cm3", "surface", "cm2/cm3"), Headline("solid.mean", "solid on this grid", "{unit}"),
        Headline("void.mean", "void on this grid", "{unit}"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "specific_surface", "surface_cm2_per_cm3", "strut.mean", "strut.deviation", "strut.between.#2",
        "strut.thinnest", "pore.mean", "pore.deviation", "pore.between.#2", "pore.thinnest", "voxel", "thinnest_wall",
        "narrowest_tunnel", "solid.mean", "solid.deviation", "solid.smallest", "solid.largest", "solid.quantiles.#3",
        "void.mean", "void.deviation", "void.smallest", "void.largest", "void.quantiles.#3", "solid_limit_mm",
        "void_limit_mm", "thin_solid_share", "narrow_void_share",
    )  # fmt: skip

    resolution: int = options.resolution(64, note="of a field", minimum=8, maximum=512)
    printable: Length | None = option(
        None,
        help="smallest wall and opening that the printer makes; thinner ones of the design are warned about",
        unit="mm",
        above=0,
        maximum=1e6,
    )
    nozzle: Length | None = option(
        None, help="diameter of the nozzle that extrudes filament; slicers leave out or widen what is thinner",
        unit="mm", above=0, maximum=100,
    )  # fmt: skip
    powder: tuple[Length, Length] | None = option(
        None, help="thinnest strut that a powder process makes, and narrowest opening that powder leaves", unit="mm",
        above=0, maximum=100,
    )  # fmt: skip
    fail: tuple[str, ...] = options.fail((), note="'thin > 0.05' and 'narrow > 0.1', as shares")

    def check_options(self) -> None:
        """Rules that can be read, and a limit for them."""
        for rule in self.fail:
            parse_rule(rule, MEASURES)
            limit = self.limits()["narrow" if rule.strip().startswith("narrow") else "thin"]
            if limit is None:
                raise ConfigError(
                    f"{rule!r} in `fail` compares with a limit, and there is none",
                    hint="give `printable`, `powder`, or, for walls, `nozzle`",
                )

    def limits(self) -> dict[str, float | None]:
        """Smallest strut and smallest opening that the machine makes, mm; None where nothing says so."""
        walls = [length.mm() for length in (self.printable, self.nozzle, self.powder and self.powder[0]) if length]
        openings = [length.mm() for length in (self.printable, self.powder and self.powder[1]) if length]
        return {"thin": max(walls, default=None), "narrow": max(openings, default=None)}

    def estimate(self, palette: Palette, source: Size) -> Size:
        grid = source if source.voxels else source.grid(self.resolution)
        voxels = source.voxels or grid.samples
        # balls grow with the resolution, and so does the number of voxels that each of them covers
        along = voxels ** (1 / 3) if source.voxels else self.resolution
        return Size(samples=grid.samples, sums=grid.sums, voxels=along * voxels, resident=voxels)

    def run(self, context: Context, source: ScalarField | Voxels) -> None:
        """Paint balls into both phases."""
        sized = source.physical if isinstance(source, Voxels) else source.edge_mm is not None
        if any(self.limits().values()) and not sized:
            raise ConfigError(
                "what the machine makes is a length in mm, but the cell has no physical size",
                hint="give the first sampling stage `edge: 7.5 mm`, or lay the cell with a `tile` stage and its `cell`",
            )
        if isinstance(source, Voxels):
            if len(set(source.spacing)) > 1:
                raise ConfigError(f"sizes need cubic voxels, these have edges {source.spacing}")
            solid = np.ascontiguousarray(source.solid().T).view(np.uint8)
            spacing, physical, periodic = source.spacing[0], source.physical, source.periodic
        else:
            cells = source.cells
            if np.prod(cells, dtype=float) * self.resolution**3 > MAX_VOXELS:
                raise ResourceError(
                    f"{' x '.join(map(str, cells))} cells of {self.resolution}^3 voxels are more than the limit of "
                    f"{MAX_VOXELS} voxels",
                    hint="lower `resolution`, or take fewer cells",
                )
            solid, area = _solid_and_area(source, self.resolution, context.threads)
            spacing, physical = (source.edge_mm or 1.0) / self.resolution, source.edge_mm is not None
            periodic = (source.periodic,) * 3
            context.report(specific_surface=area / (source.edge_mm or 1.0))
            if physical:
                context.report(surface_cm2_per_cm3=10 * area / spacing / self.resolution)
            self._compare(context, source)
        from sppm_pipeline.services.local_thickness import limit_sizes, local_thickness

        coarse = None if isinstance(source, Voxels) else _solid(source, self.resolution // 2, context.threads)
        context.report(unit="mm" if physical else "cell size", voxel=spacing)
        limits = self.limits()
        found: dict[str, float | None] = {}
        phases = (("solid", "thin", solid), ("void", "narrow", 1 - solid))
        for number, (name, small, phase) in enumerate(phases):
            thickness = local_thickness(phase, periodic)
            described, share = _described(thickness, spacing, limits[small])
            context.report(**{name: described})
            if coarse is not None:
                scale = spacing * self.resolution
                half = local_thickness(coarse if number == 0 else 1 - coarse, periodic)
                if described is not None and half.any():
                    found_limit = limit_sizes(thickness, half, (spacing, scale / (self.resolution // 2)))
                    mean, deviation, low, high, thinnest = found_limit
                    sizes = {"mean": mean, "deviation": deviation, "between": [low, high], "thinnest": thinnest}
                    context.report(**{PEOPLE[name]: sizes})
            if limits[small] is not None:
                found[MEASURES[small].number] = share
                context.report(**{f"{name}_limit_mm": limits[small]})
            context.progress(number + 1, 2, "phases")
        context.report(**found)
        self._judge(context, found, limits, spacing)

    def _judge(
        self, context: Context, found: dict[str, float | None], limits: dict[str, float | None], voxel: float
    ) -> None:
        """Warn of shares beyond a limit, and refuse what breaks a rule."""
        for small, limit in limits.items():
            if limit is None:
                continue
            if limit < MIN_VOXELS_ACROSS * voxel:
                context.warn(
                    f"{limit:g} mm are {limit / voxel:.2g} voxels, and sizes come out too small by up to three: raise "
                    "`resolution`"
                )
            measure = MEASURES[small]
            if (share := found.get(measure.number)) is not None and share > WARNED_FRACTION:
                context.warn(f"{measure.text}: {share:.1%}, below {limit:g} mm")
        broken = [text for rule in self.fail if (text := parse_rule(rule, MEASURES).broken_by(found))]
        if broken:
            raise Rejected(
                f"the design is rejected: {'; '.join(broken)}",
                hint="make walls thicker or the cell larger, or take the rule off `fail`",
            )

    def _compare(self, context: Context, field: ScalarField) -> None:
        """Report the thinnest wall and the narrowest tunnel of the design, and warn of those that can't be printed."""
        scale, unit = field.edge_mm or 1.0, "mm" if field.edge_mm else "cell size"
        radius = field.finest_radius
        designed = {"thinnest_wall": field.thinnest_wall, "narrowest_tunnel": radius and 2 * radius}
        found = {name: scale * size for name, size in designed.items() if size is not None}
        context.report(**found)
        thin, narrow = self.limits().values()
        if thin is None and narrow is None:
            return
        if not found:
            context.warn("the design does not say how thin its walls and tunnels are; see the measured sizes")
        for name, size in found.items():
            limit = thin if name == "thinnest_wall" else narrow
            if limit is not None and size < limit:
                context.warn(
                    f"the {name.replace('_', ' ')} measures {size:.3g} {unit}, less than what is printable "
                    f"({limit:g} mm)"
                )


def _described(thickness: F32, spacing: float, limit: float | None) -> tuple[dict[str, Any] | None, float | None]:
    """The distribution of sizes, and the share of the phase that is smaller than a limit; None for an empty phase."""
    from sppm_pipeline.services.local_thickness import size_distribution

    found = size_distribution(thickness, spacing)
    if found is None:
        return None, None
    share = None
    if limit is not None:
        small = (thickness > 0) & (thickness < np.float32(limit / spacing * (1 - 1e-6)))
        share = float(np.count_nonzero(small) / np.count_nonzero(thickness))
    return {**found._asdict(), "quantiles": list(found.quantiles)}, share


def _solid(field: ScalarField, n: int, threads: int) -> U8:
    """Voxels of the solid."""
    return np.ascontiguousarray(field.sample(cell_centers(n, field.cells), threads).T < 0).view(np.uint8)


def _solid_and_area(field: ScalarField, n: int, threads: int) -> tuple[U8, float]:
    """Voxels, and the area of the surface between them in cell sizes^2, divided by the number of cells."""
    from sppm_pipeline.services.mesh.closing import wrapped
    from sppm_pipeline.services.mesh.marching_cubes import marching_cubes
    from sppm_pipeline.services.mesh.measures import surface_area

    values = field.sample(cell_centers(n, field.cells), threads).T
    solid = (values < 0).view(np.uint8)
    # the samples of a periodic field go once around, so that the surface across the seam counts too
    vertices, faces = marching_cubes(wrapped(values) if field.periodic else values)[:2]
    return solid, surface_area(vertices, faces) / n**2 / float(np.prod(field.cells))
