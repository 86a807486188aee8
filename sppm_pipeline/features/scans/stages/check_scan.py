"""``check.scan``: what was built against its design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Headline,
    Palette,
    ScalarField,
    Size,
    Stage,
    Voxels,
    option,
    options,
)
from sppm_pipeline.features.scans.numerics.describing import balls_of
from sppm_pipeline.features.scans.numerics.registration import Motion, registered, surface_of
from sppm_pipeline.features.scans.properties import properties_of
from sppm_pipeline.method.stages.extract_phases import crossings
from sppm_pipeline.numerics import cell_centers

FAR = 5.0
"""Voxels up to which a point of the scan belongs to a surface of the design."""

MIN_MATCHED = 0.5
"""Share of the surface of a scan without a partner, below which the registration has failed."""


@dataclass(frozen=True, kw_only=True)
class CheckScan(Stage):
    """Compare a scan of what was built with its design: how far surfaces, sizes and stiffness are off.

    The scan is moved and turned onto the design (iterated nearest points), from where it stands: it should not be off
    by more than about three voxels, or half a pore. The mean distance of the surfaces, positive where the scan has more
    solid, is left out of that; twice it is the bias of thickness. With `properties`, stiffness and permeability of both
    are found on the same voxels, with mirror images of what does not repeat. Name both inputs: ``from: {design:
    tune.porosity, scan: read.scan}``.
    """

    name: ClassVar[str] = "check.scan"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("thickness_bias", "thickness bias", "{unit}"), Headline("distance.deviation", "scatter", "{unit}"),
        Headline("overlap", "overlap (IoU)"), Headline("porosity", "porosity, scan and design"),
        Headline("stiffness_ratio", "stiffness over the design's"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "thickness_bias", "distance.mean", "distance.deviation", "distance.quantiles.#5", "matched", "overlap",
        "shift.#3", "angle", "porosity.#2", "thickness.#2", "stiffness_ratio", "permeability_ratio", "voxel",
    )  # fmt: skip

    resolution: int = options.resolution(64, note="of the scan, whose voxels the design is sampled with, too")
    properties: bool = option(True, help="compare stiffness and permeability as well")

    def estimate(self, palette: Palette, design: Size, scan: Size) -> Size:
        """Samples of both."""
        grids = [one.grid(self.resolution) for one in (design, scan)]
        return Size(samples=sum(g.samples for g in grids), sums=sum(g.sums for g in grids))

    def run(self, context: Context, design: ScalarField, scan: ScalarField) -> None:
        """Register, and compare."""
        if (design.edge_mm is None) != (scan.edge_mm is None):
            missing = "design" if design.edge_mm is None else "scan"
            raise ConfigError(
                f"the {missing} has no physical size, and the other one has", hint="give it an `edge`, or a `voxel`"
            )
        edge, other = scan.edge_mm or 1.0, design.edge_mm or 1.0
        voxel = edge / self.resolution
        count = max(8, round(other / voxel))
        h = np.array([voxel, other / count])
        values = [
            np.array(field.sample_zyx(grid := cell_centers(n, field.cells), 0, grid.shape[2], context.threads))
            for field, n in ((scan, self.resolution), (design, count))
        ]
        sides = [surface_of(one, crossings(one, False)) for one in values]
        if not min(len(side.points) for side in sides):
            raise DesignError("the scan or the design has no surface")
        # in voxels of the scan, from the low corner of both
        lower = (np.array(design.origin_mm) - scan.origin_mm) / voxel if design.edge_mm else np.zeros(3)
        built, meant = (
            side._replace(points=(side.points + 0.5) * step / voxel) for side, step in zip(sides, h, strict=True)
        )
        meant = meant._replace(points=meant.points + lower)
        motion, away, areas = registered(built, meant, FAR, context.threads)
        matched = float(areas.sum() / built.areas.sum())
        if matched < MIN_MATCHED:
            raise DesignError(
                f"only {matched:.0%} of the scan's surface lies near one of the design: they can't be registered",
                hint="check voxel size, axes and origin of the scan; it should be off by three voxels at most",
            )
        mean = float(away @ areas / areas.sum())
        order = np.argsort(away)
        shares = np.cumsum(areas[order]) / areas.sum()
        quantiles = [float(away[order][np.searchsorted(shares, q)]) * voxel for q in (0.05, 0.25, 0.5, 0.75, 0.95)]
        solid = [(one < 0).T for one in values]
        context.report(
            unit="mm" if scan.edge_mm else "cell size", voxel=voxel, thickness_bias=2 * mean * voxel,
            distance={"mean": mean * voxel, "quantiles": quantiles,
                      "deviation": float(np.sqrt(((away - mean) ** 2) @ areas / areas.sum())) * voxel},
            matched=matched, shift=(motion.shift * voxel).tolist(), angle=motion.angle,
            overlap=_overlap(values, motion, lower, h / voxel, design.periodic),
            porosity=[1 - float(one.mean()) for one in solid],
            thickness=[float(step) * balls_of(one, field.periodic, 1).mean
                       for one, field, step in zip(solid, (scan, design), h, strict=True)],
        )  # fmt: skip
        if self.properties:
            found = [
                properties_of(
                    context, Voxels.from_array(one.astype(np.uint8), spacing=float(step), periodic=field.periodic),
                    "periodic" if field.periodic else "mirror",
                )
                for one, field, step in zip(solid, (scan, design), h, strict=True)
            ]  # fmt: skip
            context.report(scan=found[0], design=found[1])
            for name in ("stiffness", "permeability"):
                context.report(**{f"{name}_ratio": found[0][name] / found[1][name] if found[1][name] else None})


def _overlap(
    values: list[NDArray[np.float32]], motion: Motion, lower: NDArray[np.float64], h: NDArray[np.float64],
    periodic: bool,
) -> float:  # fmt: skip
    """Voxels of the scan that are solid in both, over those that are in either."""
    from scipy.ndimage import map_coordinates

    scan, design = values
    either = both = 0
    for k, layer in enumerate(scan):
        j, i = np.indices(layer.shape)
        points = np.stack([i.ravel() + 0.5, j.ravel() + 0.5, np.full(layer.size, k + 0.5)], 1)
        at = (motion.of(points) - lower) / h[1] - 0.5
        meant = map_coordinates(design, at[:, ::-1].T, order=1, mode="grid-wrap" if periodic else "nearest") < 0
        built = layer.ravel() < 0
        # what the scan shows beyond the design can't be compared
        inside = periodic | ((at > -0.5) & (at < np.array(design.shape[::-1]) - 0.5)).all(1)
        both += int(np.count_nonzero(meant & built & inside))
        either += int(np.count_nonzero((meant | built) & inside))
    return both / either if either else 0.0
