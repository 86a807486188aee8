"""``measure.statistics``: two-point curves, chords, sizes, Minkowski numbers and fabric of solid and void."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, DesignError, Headline, ScalarField, Stage, Voxels, option, options
from sppm_pipeline.engine.process.budget import require_memory
from sppm_pipeline.features.scans.statistics_report import StatisticsReport
from sppm_pipeline.numerics import cell_centers
from sppm_pipeline.services.arrays import F64, Bools

BYTES_OF_A_VOXEL = 40
"""Labels, and the image padded by a quarter on each axis and its spectrum."""

MIN_VOXELS = 16
"""Along the shortest side, from which on there are two blocks of some voxels for error bars."""


@dataclass(frozen=True, kw_only=True)
class MeasureStatistics(Stage):
    """Measure the statistics of solid and void, of a field or an image: what a structure has in common with another.

    Of both phases: the two-point probability S2 over all directions (Fourier transform, padded where sides are no
    neighbors), the two-point cluster function and the lineal path along the axes, chords, and the local thickness. Of
    the void, the ball that gets in from the sides (porosimetry); of the solid, its area, mean curvature and Euler
    number (Minkowski), and the fabric tensor of mean intercept lengths; edges that are sharper than voxels show cost a
    few percent of the area. Error bars are standard errors of the mean over
    `subcubes` blocks along each axis; they need blocks larger than the structure, as neighbors count as independent.

    `StatisticsReport.table` and `plot` have the curves; `write.statistics` writes them.
    """

    name: ClassVar[str] = "measure.statistics"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = ()
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("porosity", error="porosity_error"), Headline("surface", "surface", "1/{unit}", "surface_error"),
        Headline("solid.thickness", "struts", "{unit}"), Headline("void.thickness", "pores", "{unit}"),
        Headline("euler"), Headline("anisotropy"),
    )  # fmt: skip

    resolution: int = options.resolution(64, note="of fields; images keep theirs")
    subcubes: int = option(2, help="blocks along each axis whose scatter makes the error bars; 1 for none",
                        minimum=1, maximum=8)  # fmt: skip
    distance: int | None = option(
        None, help="largest distance of the two-point curves; a quarter of the shortest side if omitted", unit="voxels",
        minimum=1, maximum=1024,
    )  # fmt: skip

    def run(self, context: Context, source: ScalarField | Voxels) -> StatisticsReport:
        """Count."""
        from sppm_pipeline.features.scans.numerics.describing import balls_of, described, entry_of

        solid, spacing, unit, wraps = sampled(context, source, self.resolution)
        shape = " x ".join(map(str, solid.shape))
        if min(solid.shape) < MIN_VOXELS:
            raise DesignError(
                f"an image of {shape} voxels is too small for statistics, which need {MIN_VOXELS} or more on each axis",
                hint="raise `resolution`, or crop less",
            )
        if solid.all() or not solid.any():
            raise DesignError(f"the image is all {'solid' if solid.all() else 'void'}: it has no statistics")
        require_memory(
            float(solid.size) * BYTES_OF_A_VOXEL, f"the statistics of {shape} voxels",
            "lower `resolution`, or crop the image", limit=context.memory_limit,
        )  # fmt: skip
        reach = min(self.distance or min(solid.shape) // 4, min(solid.shape) - 1)
        h = float(np.prod(spacing)) ** (1 / 3)
        if max(spacing) > 1.01 * min(spacing):
            context.warn(f"voxels have the edges {spacing}; distances over all directions and sizes take them as cubes")
        found = described(solid, spacing, wraps, reach, self.subcubes)
        curves: dict[str, F64] = {}
        numbers = {}
        for number, (name, phase) in enumerate((("solid", solid), ("void", ~solid))):
            along, errors = found.phases[name]
            balls = balls_of(phase, wraps, max(self.subcubes, 2))
            at, both = found.radial[name]
            curves[f"{name}.S2"] = np.stack([h * at, both, errors[0]], 1)
            for kind, curve, bar in (("cluster", along.cluster, errors[1]), ("path", along.path, errors[2])):
                curves[f"{name}.{kind}"] = np.stack([h * np.arange(len(curve)), curve, bar], 1)
            lengths = np.flatnonzero(along.chords)
            density = along.chords[lengths] / max(along.chords.sum() * h, 1e-300)
            curves[f"{name}.chords"] = np.stack([h * lengths, density, np.full(len(lengths), np.nan)], 1)
            bare = np.full(len(balls.sizes), np.nan)
            curves[f"{name}.thickness"] = np.stack([h * balls.sizes, balls.shares, bare], 1)
            mean, error = found.bars[f"{name}.chords"]
            numbers[name] = {
                "chord": h * mean, "chord_error": h * error,
                "chords": [float(a) * b for a, b in zip(along.mean_chords, spacing, strict=True)],
                "thickness": h * balls.mean, "thickness_error": h * balls.error, "deviation": h * balls.deviation,
                "connected": along.connected,
            }  # fmt: skip
            context.progress(number + 1, 2, "phases")
        low, middle, high = entry_of(~solid)
        bars = {
            key: value for name in ("porosity", "surface", "curvature", "euler")
            for key, value in zip((name, f"{name}_error"), found.bars[name], strict=True)
        }  # fmt: skip
        nx, ny, nz = solid.shape
        return StatisticsReport(
            grid=(nx, ny, nz), voxel=spacing, unit=unit, sides="periodic" if wraps else "open", **bars,
            solid=numbers["solid"], void=numbers["void"], entry=(h * low, h * middle, h * high),
            fabric=found.fabric[0], axes=found.fabric[1], curves=curves,
        )  # fmt: skip


def sampled(
    context: Context, source: ScalarField | Voxels, resolution: int
) -> tuple[Bools, tuple[float, float, float], str, bool]:
    """The solid of a field or image (x, y, z), the edges of a voxel, their unit, and whether opposite sides meet."""
    if isinstance(source, Voxels):
        return source.solid(), source.spacing, "mm" if source.physical else "cell size", all(source.periodic)
    if coarse := source.coarseness(1 / resolution):
        context.warn(coarse)
    solid = source.solid(cell_centers(resolution, source.cells), context.threads).view(np.bool_)
    return solid, ((source.edge_mm or 1.0) / resolution,) * 3, "mm" if source.edge_mm else "cell size", source.periodic
