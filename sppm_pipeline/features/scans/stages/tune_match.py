"""``tune.match``: from a scan to the recipe of a structure with the same statistics."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np

from sppm_pipeline import Context, Headline, Palette, Recipe, RecipeSize, ScalarField, Stage, Voxels, option, options
from sppm_pipeline.engine.api.registering import registry
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.scans.image_field import ImageField
from sppm_pipeline.features.scans.numerics import statistics as st
from sppm_pipeline.features.scans.numerics.describing import Balls, Phase, balls_of, curves_of
from sppm_pipeline.features.scans.numerics.stretching import matrix_of, stretch_of, stretched
from sppm_pipeline.features.scans.stages.measure_statistics import sampled
from sppm_pipeline.method.families.homogenizer import Quiet
from sppm_pipeline.method.families.tuner import HIGH, LOW, VARY, options_at, varied_option
from sppm_pipeline.method.porosity.level import cut_for_porosity
from sppm_pipeline.nouns.size import Size
from sppm_pipeline.services.arrays import F32, F64, Bools

PROPERTIES = {"stiffness": "homogenize.voxel", "permeability": "homogenize.permeability"}
"""Properties that are matched where they are asked for, and the stages that measure them."""

KINDS = ("S2", "chords", "thickness", "fabric", *PROPERTIES)
"""What is matched; the porosity always is."""

MIN_VOXELS = 16
"""Along an edge of the cell that a recipe makes."""

FINER = 2
"""Samples of a cell that is stretched over voxels of the scan, along an edge."""

SOLVER_TOLERANCE = 1e-3
"""Of stiffness and permeability, which differ by more from one draw to the next."""

MAX_ANISOTROPY = 1.15
"""Longest over shortest mean intercept length of a scan, above which a `stretch` is proposed, a heuristic: of isotropic
cells of 60 pores it is 1.1."""


@dataclass(frozen=True, kw_only=True)
class TuneMatch(Stage):
    """Find the recipe whose structure has the statistics of a scan: a twin that can be graded, simulated and printed.

    The porosity is met by the level of each trial. `vary` names options of the recipe; first `starts` points of a Sobol
    sequence between `low` and `high` are tried, then the simplex method of Nelder and Mead goes on from the best. All
    trials draw the same random numbers, so that they differ by the options alone. The distance is a mean of what
    `match` names: S2 over all directions, distributions of chords and of local thickness of both phases, fabric,
    stiffness and permeability. Of several `draws` the one that is nearest comes out.

    Recipes draw isotropic structures, and a scan need not be isotropic. With `stretch` and `turn`, those
    that `measure.statistics` says, trials are stretched and turned by them, in a box as large as the scan whose
    sides do not meet. What comes out is the cell without both, which `warp.affine` stretches and turns.

    The cell of the recipe needs the physical size that the scan has (`edge`), if it has one; it need not be that of the
    scan. Twin and scan are compared on voxels of the same size.

    What statistics do not fix is measured as well and said: stiffness and permeability of scan and twin, alike on
    voxels of the same size (`hold_out`): of fields in the limit of fine grids, and with the mirror images of what does
    not repeat. Where `match` names them, each trial is measured, on its voxels alone, which takes several times as
    long.
    """

    name: ClassVar[str] = "tune.match"
    version: ClassVar[int] = 2
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("distance"), Headline("values"), Headline("S2"), Headline("chords.solid"), Headline("thickness.solid"),
        Headline("held_out.stiffness", "stiffness"), Headline("held_out.permeability", "k"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "distance", "values.#8", "porosity", "S2", "chords.solid", "chords.void", "thickness.solid", "thickness.void",
        "fabric", "evaluations", "failed", "draw", "scan.*", "twin.*", "held_out.stiffness", "held_out.permeability",
    )  # fmt: skip

    vary: tuple[str, ...] = option(help=f"{VARY}; one or more")
    low: tuple[float, ...] = option(help=LOW, minimum=-1e15, maximum=1e15)
    high: tuple[float, ...] = option(help=HIGH, minimum=-1e15, maximum=1e15)
    match: tuple[str, ...] = option(
        ("S2", "chords", "thickness"), help="what is matched beside the porosity", choices=KINDS
    )
    stretch: tuple[float, float, float] | None = option(
        None, help="how many times longer; the twin, along x, y and z", minimum=0.05, maximum=20
    )
    turn: tuple[float, float, float] | None = options.turn(None, note="by which what was stretched is turned")
    hold_out: bool = option(True, help="measure stiffness and permeability of scan and twin")
    starts: int = option(64, help="points of the Sobol sequence that are tried first", minimum=1, maximum=4096)
    evaluations: int = options.evaluations(160)
    draws: int = options.draws(
        1, note="whose mean distance is made small, and the nearest of which comes out", maximum=100
    )
    resolution: int = options.resolution(48, note="of a scan that is a field", maximum=256)

    def check_options(self) -> None:
        """An option of the recipe for each pair of bounds."""
        if not self.vary or not len(self.vary) == len(self.low) == len(self.high):
            raise ConfigError(
                f"`vary` names {len(self.vary)} options, with {len(self.low)} values of `low` and {len(self.high)} of "
                "`high`", hint="give one of each for every option",
            )  # fmt: skip
        for name, low, high in zip(self.vary, self.low, self.high, strict=True):
            if not low < high:
                raise ConfigError(f"`low` of {name} is {low:g} and `high` {high:g}; they should rise")
        if not self.match:
            raise ConfigError("`match` is empty", hint=f"name some of {', '.join(KINDS)}")

    def estimate(self, palette: Palette, recipe: RecipeSize, scan: Size) -> Size:
        """All trials."""
        made = recipe(palette, self.draws * self.evaluations)
        return Size(design=made.design, geometry=made.geometry)

    def run(self, context: Context, recipe: Recipe, scan: ScalarField | Voxels) -> ScalarField:
        """Try, and go on from the best."""
        solid, spacing, unit, wraps = sampled(context, scan, self.resolution)
        if max(spacing) > 1.01 * min(spacing):
            raise DesignError(f"a scan is matched on cubes, and its voxels have the edges {spacing}")
        if solid.all() or not solid.any():
            raise DesignError(f"the scan is all {'solid' if solid.all() else 'void'}")
        reach = max(4, min(solid.shape) // 4)
        measured = [kind for kind in PROPERTIES if kind in self.match]

        def look(image: Bools, repeats: bool) -> Look:
            of = properties_of(context, Voxels.from_array(image, spacing=spacing[0], periodic=repeats), 0, measured)
            return Look.at(image, repeats, reach, {kind: of[kind] for kind in measured})

        target = look(solid, wraps)
        for kind, value in target.properties.items():
            if not value > 0:
                raise DesignError(f"the scan has no {kind} that could be matched: no way goes through it")
        self._advise(context, solid, wraps)
        varied = [varied_option(recipe, name) for name in self.vary]
        ranges = [one.within(a, b) for one, a, b in zip(varied, self.low, self.high, strict=True)]
        trials: dict[tuple[float, ...], tuple[float, int | None]] = {}  # the distance, and the nearest draw
        failures: list[str] = []

        def made_at(at: tuple[float, ...], draw: int) -> tuple[ScalarField, F32]:
            return self._made(context, recipe, options_at(varied, at), draw, 1 - target.share, solid.shape, spacing[0],
                              unit)  # fmt: skip

        def evaluate(place: F64) -> float:
            numbers = [a + (b - a) * float(np.clip(p, 0, 1)) for (a, b), p in zip(ranges, place, strict=True)]
            at = tuple(float(round(v)) if one.whole else v for one, v in zip(varied, numbers, strict=True))
            if at in trials:
                return trials[at][0]
            found = {}
            for draw in range(self.draws):
                try:
                    image = made_at(at, draw)[1] < 0
                except DesignError as error:
                    failures.append(error.message)
                    continue
                found[draw] = distance(target, look(image, not self._boxed), self.match)
            # a draw that fails is as far away as can be
            total = (sum(found.values()) + self.draws - len(found)) / self.draws
            trials[at] = (total, min(found, key=found.__getitem__, default=None))
            context.progress(len(trials), self.evaluations, "trials")
            return total

        self._search(evaluate, len(varied))
        for reason in dict.fromkeys(failures):
            context.warn(f"left out: {reason}")
        best = min(trials, key=lambda at: trials[at][0])
        value, nearest = trials[best]
        if nearest is None:
            raise DesignError(f"no trial made a structure: {failures[0] if failures else 'none was drawn'}")
        made, values = made_at(best, nearest)
        context.report(distance=value, values=list(best), evaluations=len(trials), failed=len(failures), draw=nearest)
        context.report(**differences(target, Look.at(values < 0, not self._boxed, reach)))
        for name, at, (a, b) in zip(self.vary, best, ranges, strict=True):
            if min(at - a, b - at) < 0.01 * (b - a):
                context.warn(f"the best {name} is {at:g}, at the end of its range from {a:g} to {b:g}: widen it")
        if self.hold_out:
            self._compare(context, scan, made, values, spacing[0], unit)
        return made

    @property
    def _boxed(self) -> bool:
        """Whether trials are mapped into a box, whose sides do not meet."""
        return self.stretch is not None or self.turn is not None

    def _advise(self, context: Context, solid: Bools, wraps: bool) -> None:
        """Warn of a scan that no recipe resembles without a stretch."""
        lengths, axes = st.fabric(st.configurations(solid, wraps), (1.0,) * 3)
        if not self._boxed and np.isfinite(lengths).all() and lengths[0] > MAX_ANISOTROPY * lengths[2]:
            stretch, turn = (", ".join(f"{v:.3g}" for v in values) for values in stretch_of(lengths, axes))
            context.warn(
                f"intercepts of the scan are {lengths[0] / lengths[2]:.3g} times as long along one axis as along "
                f"another: `stretch: [{stretch}]` and `turn: [{turn}]` make the twin likewise"
            )

    def _search(self, evaluate: Any, count: int) -> None:
        """The points of a Sobol sequence, then a simplex around the best of them."""
        from scipy.optimize import minimize
        from scipy.stats.qmc import Sobol

        starts = min(self.starts, self.evaluations)
        points = Sobol(count, scramble=False).random(2 ** math.ceil(math.log2(starts + 1)))[1 : starts + 1]
        values = [evaluate(point) for point in points]
        left = self.evaluations - starts
        if left < count + 2:
            return
        best = points[int(np.argmin(values))]
        simplex = np.vstack([best, best + np.diag(np.where(best < 0.5, 0.12, -0.12))])
        minimize(
            evaluate, best, method="Nelder-Mead", bounds=[(0, 1)] * count,
            options={"initial_simplex": simplex, "maxfev": left, "xatol": 0.004, "fatol": 1e-5},
        )  # fmt: skip

    def _made(
        self, context: Context, recipe: Recipe, options: dict[str, dict[str, Any]], draw: int, porosity: float,
        shape: tuple[int, ...], voxel: float, unit: str,
    ) -> tuple[ScalarField, F32]:  # fmt: skip
        """What the recipe makes, cut at the porosity, and its values at voxels of the cell, or of the box."""
        made = recipe.run(context, palette=context.palette, attempt=draw, options=options)
        if not isinstance(made, ScalarField) or not made.periodic:
            raise ConfigError(f"the recipe {recipe.name!r} makes no field of a cell that repeats")
        count = _count(made, voxel, unit)
        if self._boxed:
            fine = made.sample(FINER * count, context.threads)
            matrix, (nx, ny, nz) = matrix_of(self.stretch or (1.0, 1.0, 1.0), self.turn), shape
            values = stretched(fine, FINER, matrix, (nx, ny, nz))
        else:
            values = made.sample(count, context.threads)
        cut = cut_for_porosity(values, porosity).level
        return made.cut_at(cut), values - np.float32(cut)

    def _compare(
        self, context: Context, scan: ScalarField | Voxels, made: ScalarField, values: F32, voxel: float, unit: str
    ) -> None:
        """Measure and say what was not matched."""
        twin: ScalarField | Voxels = made
        count = _count(made, voxel, unit)
        if isinstance(scan, Voxels):
            twin = Voxels.from_array(values < 0, spacing=voxel, periodic=not self._boxed)
        elif self._boxed:
            twin = box = ImageField.through(values, (voxel,) * 3, physical=True, periodic=False)
            count = round(box.per_cell[0])
        pairs = (("scan", scan, self.resolution), ("twin", twin, count))
        found = {name: properties_of(context, one, resolution) for name, one, resolution in pairs}
        off = {
            key: found["twin"][key] / found["scan"][key] - 1 if found["scan"][key] else None
            for key in ("stiffness", "permeability")
        }
        context.report(held_out=off, **found)


def _count(field: ScalarField, voxel: float, unit: str) -> int:
    """Voxels of the size of the scan's along the cell, as nearly as whole numbers of them fit it."""
    if unit == "mm" and field.edge_mm is None:
        raise ConfigError(
            "the scan has a physical size, and the recipe makes a cell without one",
            hint="give the first sampling stage of the recipe an `edge`, for example `edge: 2 mm`",
        )
    count = round((field.edge_mm or 1.0 if unit == "mm" else 1.0) / voxel)
    if count < MIN_VOXELS:
        raise ConfigError(
            f"the cell of the recipe is {count} voxels of the scan wide; {MIN_VOXELS} or more are needed",
            hint="give it a larger `edge`, or the scan finer voxels (`resolution`)",
        )
    return count


class Look(NamedTuple):
    """Statistics of an image, lengths in voxels."""

    share: float  # of the solid
    pairs: F64  # S2 over distances, (m,)
    phases: tuple[Phase, Phase]  # solid, void
    balls: tuple[Balls, Balls]
    fabric: F64  # mean intercept lengths of the solid, longest first, (3,)
    properties: Mapping[str, float]  # some of `PROPERTIES`

    @classmethod
    def at(cls, solid: Bools, wraps: bool, distances: int, properties: Mapping[str, float] | None = None) -> Look:
        """Look at an image (x, y, z)."""
        void = ~solid
        return cls(
            float(solid.mean()), st.radial_pairs(solid, distances, wraps)[1],
            (curves_of(solid, distances, wraps), curves_of(void, distances, wraps)),
            (balls_of(solid, wraps, 1), balls_of(void, wraps, 1)),
            st.fabric(st.configurations(solid, wraps), (1.0,) * 3)[0], properties or {},
        )  # fmt: skip

    def chord(self, phase: int) -> float:
        """Mean chord of the solid (0) or void (1); NaN without one."""
        counts = self.phases[phase].chords
        return float(counts @ np.arange(len(counts)) / counts.sum()) if counts.any() else math.nan


def differences(scan: Look, twin: Look) -> dict[str, Any]:
    """Relative differences of a twin, with a sign where they are of numbers; of S2 the largest absolute one."""
    m, names = min(len(scan.pairs), len(twin.pairs)), ("solid", "void")
    a, b = (look.fabric[0] / look.fabric[2] if look.fabric[2] > 0 else math.nan for look in (scan, twin))
    return {
        "porosity": scan.share - twin.share, "S2": float(np.abs(scan.pairs[:m] - twin.pairs[:m]).max()),
        "chords": {name: twin.chord(k) / scan.chord(k) - 1 for k, name in enumerate(names)},
        "thickness": {name: twin.balls[k].mean / scan.balls[k].mean - 1 for k, name in enumerate(names)},
        "fabric": b / a - 1,
    }  # fmt: skip


def distance(scan: Look, twin: Look, kinds: tuple[str, ...]) -> float:
    """Root of the mean square of what is to be matched; 1 stands for another structure altogether.

    S2 counts by the root mean square difference over its range, chords and thickness by the relative difference of
    their means and the area between their distribution functions, over the mean; fabric by that of intercepts;
    stiffness and permeability by the logarithm of their ratio.
    """
    parts, off = [], differences(scan, twin)
    if "S2" in kinds:
        m = min(len(scan.pairs), len(twin.pairs))
        spread = scan.share * (1 - scan.share)
        parts.append(float(np.sqrt(np.mean((scan.pairs[:m] - twin.pairs[:m]) ** 2))) / spread)
    for number, name in enumerate(("solid", "void")):
        parts += [off[kind][name] for kind in ("chords", "thickness") if kind in kinds]
        if "chords" in kinds:
            sizes = [np.arange(len(look.phases[number].chords), dtype=float) for look in (scan, twin)]
            parts.append(_apart(sizes[0], scan.phases[number].chords, sizes[1], twin.phases[number].chords))
        if "thickness" in kinds:
            a, b = scan.balls[number], twin.balls[number]
            parts.append(_apart(a.sizes, a.shares, b.sizes, b.shares))
    if "fabric" in kinds:
        parts.append(float(np.linalg.norm(twin.fabric / twin.fabric.mean() - scan.fabric / scan.fabric.mean())))
    for kind, own in scan.properties.items():
        value = twin.properties[kind]
        parts.append(math.log(value / own) if value > 0 else 1.0)
    values = np.array(parts)
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else 1.0


def _apart(a: F64, weights_a: F64, b: F64, weights_b: F64) -> float:
    """The area between two distribution functions over the mean of the first (the distance of Wasserstein)."""
    from scipy.stats import wasserstein_distance

    if not weights_a.sum() or not weights_b.sum():
        return 1.0
    return float(wasserstein_distance(a, b, weights_a, weights_b) / (a @ weights_a / weights_a.sum()))


class _Silent(Quiet):
    """A context whose warnings and numbers go nowhere."""

    def report(self, **values: Any) -> None:
        """Drop numbers."""


def properties_of(
    context: Context, source: ScalarField | Voxels, resolution: int = 0, kinds: Iterable[str] = PROPERTIES
) -> dict[str, Any]:
    """Stiffness of the solid and permeability of the void, or one of these; with mirror images of what is not periodic.

    A field is solved on `resolution` voxels along the edge of a cell and on coarser ones, for the limit of fine grids.

    Returns
    -------
    dict
        `stiffness`, the mean of C11, C22 and C33 over Young's modulus of the solid; `C`, these three, and of fields
        the half widths `C_error`; `permeability`, the mean along the axes, mm^2, or cell sizes of what has no physical
        size; `k`, these three. All 0 where nothing carries or flows.
    """
    repeats = all(source.periodic) if isinstance(source, Voxels) else source.periodic
    given: dict[str, Any] = {"sides": "periodic" if repeats else "mirror"}
    if isinstance(source, ScalarField):
        given |= {"resolution": resolution, "solver_tolerance": SOLVER_TOLERANCE}
    silent = cast(Context, _Silent(context))
    found: dict[str, Any] = {"sides": given["sides"]}
    for name in kinds:
        number = "C" if name == "stiffness" else "k"
        try:
            made: Any = registry().get(PROPERTIES[name])
            report = made(**given).run(silent, source)
            tensor = report.stiffness[:3, :3] if number == "C" else report.k * (report.edge_mm or 1.0) ** 2
            values = [float(value) for value in np.diag(tensor)]
            if number == "C" and report.error is not None:
                found["C_error"] = [float(value) for value in np.diag(report.error)[:3]]
        except DesignError:  # no way through along any axis
            values = [0.0, 0.0, 0.0]
        found |= {name: sum(values) / 3, number: values}
    return found
