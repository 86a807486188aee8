"""``tune.match``: from a scan to the recipe of a structure with the same statistics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Headline,
    Palette,
    Recipe,
    RecipeSize,
    ScalarField,
    Size,
    Stage,
    Voxels,
    option,
    options,
)
from sppm_pipeline.features.scans.numerics.matching import KINDS, Look, differences, distance
from sppm_pipeline.features.scans.properties import properties_of
from sppm_pipeline.features.scans.stages.measure_statistics import sampled
from sppm_pipeline.method.families.tuner import HIGH, LOW, VARY, Varied, options_at, varied_option
from sppm_pipeline.numerics import cell_centers

MIN_VOXELS = 16
"""Along an edge of the cell that a recipe makes."""


@dataclass(frozen=True, kw_only=True)
class TuneMatch(Stage):
    """Find the recipe whose structure has the statistics of a scan: a twin that can be graded, simulated and printed.

    The porosity is met by the level of each trial. `vary` names options of the recipe; first `starts` points of a Sobol
    sequence between `low` and `high` are tried, then the simplex method of Nelder and Mead goes on from the best. All
    trials draw the same random numbers, so that they differ by the options alone. The distance is a mean of what
    `match` names: S2 over all directions, distributions of chords and of local thickness of both phases, and fabric.

    The cell of the recipe needs the physical size that the scan has (`edge`), if it has one; it need not be that of the
    scan. Twin and scan are compared on voxels of the same size.

    What statistics do not fix is measured as well and said: stiffness and permeability of scan and twin, on the same
    voxels (`hold_out`), that of a scan which does not repeat with its mirror images.
    """

    name: ClassVar[str] = "tune.match"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("distance"), Headline("values"), Headline("S2"), Headline("chords.solid"), Headline("thickness.solid"),
        Headline("held_out.stiffness", "stiffness, not matched"), Headline("held_out.permeability", "k, not matched"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "distance", "values.#8", "porosity", "S2", "chords.solid", "chords.void", "thickness.solid", "thickness.void",
        "fabric", "evaluations", "failed", "scan.*", "twin.*", "held_out.stiffness", "held_out.permeability",
    )  # fmt: skip

    vary: tuple[str, ...] = option(help=f"{VARY}; one or more")
    low: tuple[float, ...] = option(help=LOW, minimum=-1e15, maximum=1e15)
    high: tuple[float, ...] = option(help=HIGH, minimum=-1e15, maximum=1e15)
    match: tuple[str, ...] = option(
        ("S2", "chords", "thickness"), help="statistics that are matched beside the porosity", choices=KINDS
    )
    hold_out: bool = option(True, help="measure stiffness and permeability of scan and twin")
    starts: int = option(64, help="points of the Sobol sequence that are tried first", minimum=1, maximum=4096)
    evaluations: int = options.evaluations(160)
    draws: int = options.draws(1, note="whose mean distance is made small", maximum=100)
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
        target = Look.at(solid, wraps, reach)
        varied = [varied_option(recipe, name) for name in self.vary]
        ranges = [one.within(a, b) for one, a, b in zip(varied, self.low, self.high, strict=True)]
        trials: dict[tuple[float, ...], tuple[float, ScalarField | None]] = {}
        failures: list[str] = []

        def evaluate(place: NDArray[np.float64]) -> float:
            at = tuple(
                _rounded(one, a + (b - a) * float(np.clip(p, 0, 1)))
                for one, (a, b), p in zip(varied, ranges, place, strict=True)
            )
            if at in trials:
                return trials[at][0]
            found, first = [], None
            for draw in range(self.draws):
                try:
                    twin, image = self._made(context, recipe, varied, at, draw, 1 - target.share, spacing[0], unit)
                except DesignError as error:
                    failures.append(error.message)
                    continue
                found.append(distance(target, Look.at(image, True, reach), self.match))
                first = twin if first is None else first
            # a draw that fails is as far away as can be
            total = (sum(found) + self.draws - len(found)) / self.draws
            trials[at] = (total, first)
            context.progress(len(trials), self.evaluations, "trials")
            return total

        self._search(evaluate, len(varied))
        for reason in dict.fromkeys(failures):
            context.warn(f"left out: {reason}")
        best = min(trials, key=lambda at: trials[at][0])
        value, made = trials[best]
        if made is None:
            raise DesignError(f"no trial made a structure: {failures[0] if failures else 'none was drawn'}")
        image = _image(made, spacing[0], unit, context.threads)
        context.report(distance=value, values=list(best), evaluations=len(trials), failed=len(failures))
        found = differences(target, Look.at(image, True, reach))
        context.report(**{name: number for name, number in found.items() if "." not in name})
        for kind in ("chords", "thickness"):
            context.report(**{kind: {phase: found[f"{kind}.{phase}"] for phase in ("solid", "void")}})
        for name, at, (a, b) in zip(self.vary, best, ranges, strict=True):
            if min(at - a, b - at) < 0.01 * (b - a):
                context.warn(f"the best {name} is {at:g}, at the end of its range from {a:g} to {b:g}: widen it")
        if self.hold_out:
            self._compare(context, solid, image, spacing[0], wraps)
        return made

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
        self, context: Context, recipe: Recipe, varied: Sequence[Varied], at: Sequence[float], draw: int,
        porosity: float, voxel: float, unit: str,
    ) -> tuple[ScalarField, NDArray[np.bool_]]:  # fmt: skip
        """What the recipe makes, cut at the porosity, and its voxels."""
        made = recipe.run(context, palette=context.palette, attempt=draw, options=options_at(varied, at))
        if not isinstance(made, ScalarField) or not made.periodic:
            raise ConfigError(f"the recipe {recipe.name!r} makes no field of a cell that repeats")
        values = made.sample(_grid(made, voxel, unit), context.threads)
        rank = min(max(round((1 - porosity) * values.size), 1), values.size - 1)
        ordered = np.partition(values.ravel(order="K"), (rank - 1, rank))
        cut = float(ordered[rank - 1] / 2 + ordered[rank] / 2)
        return made.cut_at(cut), values < cut

    def _compare(
        self, context: Context, scan: NDArray[np.bool_], twin: NDArray[np.bool_], voxel: float, wraps: bool
    ) -> None:
        """Measure and say what was not matched."""
        found = {}
        for name, solid, repeats in (("scan", scan, wraps), ("twin", twin, True)):
            image = Voxels.from_array(solid.astype(np.uint8), spacing=voxel, periodic=repeats)
            found[name] = properties_of(context, image, "periodic" if repeats else "mirror")
            context.report(**{name: found[name]})
        off = {
            key: found["twin"][key] / found["scan"][key] - 1 if found["scan"][key] else None
            for key in ("stiffness", "permeability")
        }
        context.report(held_out=off)


def _rounded(varied: Varied, value: float) -> float:
    return float(round(value)) if varied.whole else value


def _grid(field: ScalarField, voxel: float, unit: str) -> Any:
    """Voxels of the size of the scan's, as nearly as whole numbers of them fit the cell."""
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
    return cell_centers(count, field.cells)


def _image(field: ScalarField, voxel: float, unit: str, threads: int) -> NDArray[np.bool_]:
    return field.sample(_grid(field, voxel, unit), threads) < 0
