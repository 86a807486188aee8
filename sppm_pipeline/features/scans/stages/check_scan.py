"""``check.scan``: what was built against its design."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import Context, Headline, Palette, ScalarField, Size, Stage, Voxels, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.scans.numerics.describing import balls_of
from sppm_pipeline.features.scans.stages.tune_match import properties_of
from sppm_pipeline.method.stages.extract_phases import crossings
from sppm_pipeline.numerics import cell_centers
from sppm_pipeline.services.arrays import F32, F64, Bools

FAR = 5.0
"""Voxels up to which a point of the scan belongs to a surface of the design."""

MIN_MATCHED = 0.5
"""Share of the surface of a scan without a partner, below which the registration has failed."""

MAX_POINTS = 20_000
"""Points that decide the motion; more do not change it beyond a hundredth of a voxel."""

MAX_ROUNDS = 60


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
        from scipy.spatial.transform import Rotation

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
            matched=matched, shift=(motion.shift * voxel).tolist(),
            angle=float(np.degrees(Rotation.from_matrix(motion.turn).magnitude())),
            overlap=_overlap(values, motion, lower, h / voxel, design.periodic),
            porosity=[1 - float(one.mean()) for one in solid],
            thickness=[float(step) * balls_of(one, field.periodic, 1).mean
                       for one, field, step in zip(solid, (scan, design), h, strict=True)],
        )  # fmt: skip
        if self.properties:
            found = [
                properties_of(context, Voxels.from_array(one, spacing=float(step), periodic=field.periodic))
                for one, field, step in zip(solid, (scan, design), h, strict=True)
            ]
            context.report(scan=found[0], design=found[1])
            for name in ("stiffness", "permeability"):
                context.report(**{f"{name}_ratio": found[0][name] / found[1][name] if found[1][name] else None})


def _overlap(values: list[F32], motion: Motion, lower: F64, h: F64, periodic: bool) -> float:
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


class Surface(NamedTuple):
    """Points (n, 3), their outward normals (n, 3), and the area that each stands for (n,), in any unit."""

    points: F64
    normals: F64
    areas: F64


def surface_of(values: F32, crossings: F64) -> Surface:
    """The surface of samples (z, y, x) at the points where lines of the grid cross it, (n, 3) x, y, z in its steps."""
    from scipy.ndimage import map_coordinates

    at = crossings[:, ::-1].T
    slopes = [map_coordinates(part, at, order=1, mode="nearest") for part in np.gradient(values.astype(np.float64))]
    normals = np.stack(slopes[::-1], 1)
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    # lines of the grid cross a surface as often as its normal leans towards all axes
    return Surface(crossings, normals, 1 / np.maximum(np.abs(normals).sum(1), 1e-9))


class Motion(NamedTuple):
    """``x -> turn (x - middle) + middle + shift``."""

    turn: F64  # (3, 3)
    shift: F64  # (3,)
    middle: F64

    def of(self, points: F64) -> F64:
        """Points (n, 3), moved."""
        return np.asarray((points - self.middle) @ self.turn.T + self.middle + self.shift)


def registered(scan: Surface, design: Surface, far: float, threads: int = 1) -> tuple[Motion, F64, F64]:
    """The motion that lays the surface of a scan onto that of its design, distances afterwards, and their areas.

    Each round finds the nearest points of the design and moves the scan so that its distances to the planes there have
    the least squares about a common distance (Chen and Medioni 1992), as surfaces that grew everywhere are no motion.
    Distances (m,) are positive outside of the design, of up to `far`, in the unit of the points.
    """
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    tree = cKDTree(design.points)
    middle = scan.points.mean(0)
    motion = Motion(np.eye(3), np.zeros(3), middle)
    step = max(1, len(scan.points) // MAX_POINTS)
    points, normals, areas = (each[::step] for each in scan)
    for _ in range(MAX_ROUNDS):
        moved = motion.of(points)
        away, plane, fits = _distances(tree, design, moved, normals @ motion.turn.T, far, threads)
        w = np.sqrt(areas[fits])
        arm = moved[fits] - (middle + motion.shift)
        system = np.hstack([plane, np.cross(arm, plane), -np.ones((len(plane), 1))])
        found = np.linalg.lstsq(system * w[:, None], -away * w, rcond=None)[0]
        motion = Motion(Rotation.from_rotvec(found[3:6]).as_matrix() @ motion.turn, motion.shift + found[:3], middle)
        if np.linalg.norm(found[:3]) + np.linalg.norm(found[3:6]) * far < 1e-5 * far:
            break
    away, _, fits = _distances(tree, design, motion.of(scan.points), scan.normals @ motion.turn.T, far, threads)
    return motion, away, scan.areas[fits]


def _distances(
    tree: Any, design: Surface, points: F64, normals: F64, far: float, threads: int
) -> tuple[F64, F64, Bools]:
    """Distances to the planes at the nearest points, these planes' normals, and which points have any that fits."""
    away, nearest = tree.query(points, workers=threads)
    planes = design.normals[nearest]
    # another side of a thin wall is no partner
    fits = (away < far) & ((planes * normals).sum(1) > 0.5)
    along = ((points - design.points[nearest]) * planes).sum(1)
    return along[fits], planes[fits], fits
