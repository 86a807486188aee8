"""``tune.porosity``: find the number of pores, then the level or the gap, for a target porosity."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Length, Microstructure, Palette, PoreSet, RecipeSize, ScalarField, Size, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families.kernel_radii import radii_of, radius_warning, reported_radii, with_radii
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.stage import Context, Headline, Recipe, Stage, option

Options = dict[str, dict[str, Any]]

OFF_SYMMETRY = (0.3090, 0.7236, 0.1459)
"""Place of the first point, as fractions of the distance of points: irrational ones, so that no lattice meets them."""

MAX_SAMPLES = 1.5e8
"""Samples of a field at once; a single cell of 512 voxels along its edge has as many."""

RADIUS_STEP = 1.25
"""Factor by which a radius is changed until the target is enclosed; not sensitive, as a search follows."""

FULL = 0.92
"""Share of the packing limit up to which an interior is filled: dart throwing takes up to 500 tries a pore at 0.9, and
gives up soon after."""

MAX_RADIUS_FACTOR = 8.0
"""Change of a radius, up or down, beyond which the search is given up: other numbers of pores are needed then."""


@dataclass(frozen=True, kw_only=True)
class TunePorosity(Stage):
    """Reach a porosity within 0.001 of the volume (paper, section "Porosity Control").

    First the number of pores n: a straight line through the porosities of trial cells gives the n for the target, at
    constant packing. Then fine: the level is set to the quantile of the field, which reaches any target in one pass,
    or, as in the paper, the gap d between faces and interior is searched, on the branch d >= spacing where porosity
    falls with d. The result is checked on an independent, finer grid.

    Another level changes the radii of pores and tunnels, which are reported beside those asked for. To keep one of
    them, `hold` it: the level stays, and the other radius is searched. With `fit_count` the number of pores comes
    first, so that the other radius changes little, too.

    `by: gap` keeps the level and both radii. Porosity jumps where the gap changes which darts are discarded, so a cell
    may step over the target; then up to three pores more or less than the fitted line says, and further draws, are
    tried.

    A recipe that makes any other field is tuned by level: the field is cut at its quantile, which such a field may call
    a strut radius or a wall thickness.
    """

    name: ClassVar[str] = "tune.porosity"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("porosity"), Headline("count", "pores"), Headline("gap"), Headline("draw"), Headline("level"),
        Headline("pore_radius", "pore radius"), Headline("pore_radius_asked", "asked for"),
        Headline("tunnel_radius", "tunnel radius"), Headline("tunnel_radius_asked", "asked for"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "count", "line.slope", "line.intercept", "line.r_squared", "line.residual_sd", "line.largest_residual",
        "line.n_min", "line.n_max", "line.samples", "porosity", "porosity_error", "checked_at", "level",
        "gap_evaluations", "gap", "draw", "radius_evaluations", "pore_radius", "tunnel_radius", "pore_radius_asked",
        "tunnel_radius_asked", "pore_radius_mm", "tunnel_radius_mm", "pore_radius_asked_mm", "tunnel_radius_asked_mm",
    )  # fmt: skip

    target: float = options.target(note="the porosity", below=1)
    by: str = option("level", help="what is tuned at last", choices=("level", "gap"))
    hold: str | None = option(
        None, help="radius that stays as the recipe states it, while the other one is tuned instead of the level",
        choices=("tunnel_radius", "pore_radius"),
    )  # fmt: skip
    fit_count: bool = option(
        False, help="choose the number of pores by a fitted line; the recipe's stages then need `total`"
    )
    trials: int = options.trials(3, note="on the line", formerly="samples")
    resolution: int = options.resolution(64, minimum=8, maximum=512)
    tolerance: float = options.tolerance(0.001)
    evaluations: int = options.evaluations(400, note="cells measured while the gap is searched")

    def check_options(self) -> None:
        """A gap needs nothing held."""
        if self.by == "gap" and self.hold is not None:
            raise ConfigError("`by: gap` keeps both radii; leave out `hold`, which is for `by: level`")

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        n, trials = self.resolution, 8 * self.trials if self.fit_count else 0
        # most cells take one to three searches of six gaps each; a search of a radius takes six measurements
        draws = min(self.evaluations, 12) if self.by == "gap" else 6 if self.hold else 1
        made = recipe(palette, trials + draws)
        grids = [(trials, made.grid(max(24, n // 2))), (draws, made.grid(n)), (draws, made.grid(n + n // 2 + 1))]
        return made.at_porosity(
            self.target, samples=sum(times * grid.samples for times, grid in grids),
            sums=sum(times * grid.sums for times, grid in grids), resident=grids[-1][1].resident,
        )  # fmt: skip

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Tune the recipe."""
        options: Options = {}
        if self.fit_count:
            options = self._fitted_count(context, recipe)
        if self.by == "gap":
            return self._by_gap(context, recipe, options)
        if self.hold is not None:
            return self._by_radius(context, recipe, options)
        return self._by_level(context, recipe, options)

    def _porosity(self, context: Context, field: ScalarField, n: int) -> float:
        return float((field.sample(_points(field, n), context.threads) >= 0).mean())

    def _draw(
        self, context: Context, recipe: Recipe, options: Mapping[str, Mapping[str, Any]], attempt: int = 0
    ) -> ScalarField:
        made = recipe.run(context, palette=context.palette, attempt=attempt, options=options)
        if not isinstance(made, ScalarField):
            raise ConfigError(
                f"the recipe {recipe.name!r} makes a {type(made).__name__}; tuning needs a field",
                hint="end the recipe with a stage such as `field.gaussian`",
            )
        return made

    def _draw_pores(
        self, context: Context, recipe: Recipe, options: Mapping[str, Mapping[str, Any]], attempt: int = 0
    ) -> Microstructure:
        made = self._draw(context, recipe, options, attempt)
        if not isinstance(made, Microstructure):
            raise ConfigError(
                f"the recipe {recipe.name!r} makes a {type(made).__name__}, which has no pores and tunnels",
                hint="end the recipe with `field.gaussian`, or tune `by: level` without `hold`",
            )
        return made

    def _fitted_count(self, context: Context, recipe: Recipe) -> Options:
        """The number of pores at which the fitted line meets the target, as options of the recipe."""
        from sppm_pipeline.method.porosity.line import PorosityLine, count_for_porosity, fit_line, predict_porosity

        stages = [i for i, values in recipe.options().items() if values.get("total") is not None]
        if not stages:
            raise ConfigError(
                "`fit_count` needs stages with the option `total`",
                hint="give the samplers of the recipe `total: 100` and `share: 0.5` instead of `count`",
            )
        gapped = _with_gap_option(recipe) if self.by == "gap" else []
        start = int(recipe.options()[stages[0]]["total"])
        coarse = max(24, self.resolution // 2)
        counts: list[int] = []
        porosities: list[float] = []

        def probe(n: int) -> None:
            changed: Options = {stage: {"total": n} for stage in stages}
            for sample in range(self.trials):
                cell = self._draw(context, recipe, changed, 1 + sample)
                if gapped and isinstance(cell, Microstructure) and (ends := _gaps(cell.graph.pores)) is not None:
                    # on the branch on which the gap is searched, porosity is lower than at the default gap
                    on_branch = _with_gap(changed, gapped, sum(ends) / 2)
                    cell = self._draw(context, recipe, on_branch, 1 + sample)
                counts.append(n)
                porosities.append(self._porosity(context, cell, coarse))

        for factor in (0.5, 0.75, 1.0, 1.5, 2.0):
            probe(max(4, round(start * factor)))

        def nearest() -> PorosityLine:
            """The line through the three numbers of pores whose porosity is nearest to the target."""
            # far from the target porosity saturates and bends the line away
            order = np.unique(counts)
            mean = np.array([np.mean([p for n, p in zip(counts, porosities, strict=True) if n == c]) for c in order])
            used = np.isin(counts, order[np.argsort(np.abs(mean - self.target), kind="stable")[:3]])
            return fit_line(np.array(counts)[used], np.array(porosities)[used])

        for _ in range(6):  # the line is trusted only between its points
            line = nearest() if min(porosities) <= self.target <= max(porosities) else None
            if line is not None and line.reaches(self.target):
                break
            lowest = min(porosities) if line is None else predict_porosity(line, line.n_min)
            probe(max(4, min(counts) // 2) if self.target < lowest else max(counts) * 3 // 2)
        line = nearest()
        n = count_for_porosity(line, self.target)
        context.report(count=n, line=line._asdict())
        return {stage: {"total": n} for stage in stages}

    def _by_level(self, context: Context, recipe: Recipe, options: Options) -> ScalarField:
        field = self._draw(context, recipe, options)
        drawn = field
        n = self.resolution
        error = np.inf
        for _ in range(3):  # the porosity of a coarse grid is off by its voxels at the surface
            field = self._cut(context, field, n)
            finer = n + n // 2 + 1
            reached = self._porosity(context, field, finer)
            error = reached - self.target
            if abs(error) <= self.tolerance:
                context.report(porosity=reached, porosity_error=error, checked_at=finer)
                if isinstance(field, Microstructure) and isinstance(drawn, Microstructure):
                    asked = radii_of(drawn)
                    context.report(level=field.level, **reported_radii(field, asked))
                    if warning := radius_warning(field, asked):
                        context.warn(warning)
                return field
            n = finer
        if isinstance(drawn, Microstructure):
            self._check_alone(context, drawn, "tunnel")
        raise DesignError(
            f"the porosity {self.target:g} is missed by {error:.5f} on a grid of {n} voxels along an edge of the cell; "
            f"allowed are {self.tolerance:g}",
            hint=f"measure on a finer grid, for example `resolution: {2 * self.resolution}`",
        )

    def _cut(self, context: Context, field: ScalarField, n: int) -> ScalarField:
        from sppm_pipeline.method.porosity.level import cut_for_porosity, level_for_porosity

        points = _points(field, n)
        if isinstance(field, Microstructure):  # its kernels reach only so far: below level 0 there is nothing
            return field.with_level(level_for_porosity(field.sums(points, context.threads), self.target).level)
        return field.cut_at(cut_for_porosity(field.sample(points, context.threads), self.target).level)

    def _check_alone(self, context: Context, micro: Microstructure, kept: str) -> None:
        """Raise `DesignError` if the ``tunnel``s or ``pore``s alone, at their radius, make more void than is wanted."""
        radius = getattr(radii_of(micro), kept)
        # the others so small that no sample finds them
        alone = with_radii(micro, **{"pore" if kept == "tunnel" else "tunnel": 1e-3})
        porosity = self._porosity(context, alone, self.resolution)
        if not radius or porosity <= self.target:
            return
        factor, _, _ = self._radius_factor(context, lambda f: with_radii(alone, **{kept: f}))
        largest = factor * radius
        millimeters = f" ({largest * micro.edge_mm:.3g} mm)" if micro.edge_mm is not None else ""
        fewer = ", fewer pores, or fewer tunnels (`degree`)" if kept == "tunnel" else " or fewer pores"
        raise DesignError(
            f"{kept}s of a radius of {radius:.4g} cell sizes alone make a porosity of {porosity:.4f}, more than the "
            f"{self.target:g} asked for; {'pores' if kept == 'tunnel' else 'tunnels'} add to that",
            hint=f"at this number of {kept}s their radius must be below {largest:.3g} cell sizes{millimeters}; give "
            f"a smaller `{kept}_radius`{fewer}",
        )

    def _radius_factor(self, context: Context, made: Callable[[float], Microstructure]) -> tuple[float, float, int]:
        """The factor of a radius that gives the target, the porosity that it gives, and how many were tried."""
        # porosity grows with either radius: the target is enclosed by steps, and searched between the last two
        from sppm_pipeline.method.porosity.level import search_monotone

        finer = self.resolution + self.resolution // 2 + 1
        known: dict[float, float] = {}

        def reached(exponent: float) -> float:
            if exponent not in known:
                known[exponent] = self._porosity(context, made(math.exp(exponent)), finer)
            return known[exponent]

        step = math.copysign(math.log(RADIUS_STEP), self.target - reached(0.0))
        before, at = 0.0, step
        while (reached(at) - self.target) * step < 0 and abs(at) < math.log(MAX_RADIUS_FACTOR):
            before, at = at, at + step
        # half of the tolerance, as the search measures on one grid alone
        found = search_monotone(reached, min(before, at), max(before, at), self.target, self.tolerance / 2)
        return math.exp(found.x), found.value, len(known)

    def _by_radius(self, context: Context, recipe: Recipe, options: Options) -> Microstructure:
        micro = self._draw_pores(context, recipe, options)
        asked = radii_of(micro)
        moved = "pore" if self.hold == "tunnel_radius" else "tunnel"
        self._check_alone(context, micro, "tunnel" if moved == "pore" else "pore")
        factor, porosity, evaluations = self._radius_factor(context, lambda f: with_radii(micro, **{moved: f}))
        if abs(porosity - self.target) > self.tolerance:
            raise DesignError(
                f"no {moved} radius from 1/{MAX_RADIUS_FACTOR:g} to {MAX_RADIUS_FACTOR:g} times the one asked for "
                f"gives the porosity {self.target:g}; the best is {factor:.3g} times with {porosity:.5f}",
                hint="take another number of pores (`fit_count: true`), or hold the other radius",
            )
        made = with_radii(micro, **{moved: factor})
        finer = self.resolution + self.resolution // 2 + 1
        context.report(
            porosity=porosity, porosity_error=porosity - self.target, checked_at=finer, level=made.level,
            radius_evaluations=evaluations, **reported_radii(made, asked),
        )  # fmt: skip
        return made

    def _by_gap(self, context: Context, recipe: Recipe, options: Options) -> Microstructure:
        from sppm_pipeline.method.families.gap_search import OFFSETS, Candidate, search_gap

        samplers = _with_gap_option(recipe)
        if not samplers:
            raise ConfigError(
                "`by: gap` needs a sampler with the option `gap` in the recipe", hint="use `sample.dart_throwing`"
            )
        finer = self.resolution + self.resolution // 2 + 1
        evaluated = 0

        def varied(candidate: Candidate) -> Options:
            return {
                i: {name: value + candidate.extra if name == "total" else value for name, value in values.items()}
                for i, values in options.items()
            }

        def interval(candidate: Candidate) -> tuple[float, float] | None:
            return _gaps(self._draw_pores(context, recipe, varied(candidate), candidate.draw).graph.pores)

        def evaluate(candidate: Candidate, gap: float) -> tuple[float, Microstructure]:
            nonlocal evaluated
            changed = _with_gap(varied(candidate), samplers, gap)
            made = self._draw_pores(context, recipe, changed, candidate.draw)
            evaluated += 1
            context.progress(evaluated, self.evaluations, "gaps tried")
            return self._porosity(context, made, finer), made

        drawn = self._draw_pores(context, recipe, options)
        offsets = OFFSETS if options else OFFSETS[:1]  # without a fitted line the number of pores is the user's
        # three quarters of the tolerance, as the search measures on one grid alone
        aim = 0.75 * self.tolerance
        best, tried = search_gap(interval, evaluate, offsets, self.target, aim, self.evaluations)
        context.report(gap_evaluations=tried)
        if best is None:
            raise DesignError(
                "the interior is too full to make the gap wider than the spacing of "
                f"{drawn.graph.pores.spacing:g} cell sizes",
                hint="give fewer pores or a smaller spacing, or tune `by: level`",
            )
        if abs(best.porosity - self.target) > self.tolerance:
            raise DesignError(
                f"none of {tried} cells with gaps of at least the spacing has the porosity {self.target:g}; the best "
                f"is the gap {best.gap:g} with {best.porosity:.5f}",
                hint="tune `by: level`"
                + ("" if self.fit_count else ", or let the number of pores be chosen (`fit_count: true`)"),
            )
        if options:
            context.report(count=int(next(iter(varied(best.candidate).values()))["total"]))
        context.report(
            porosity=best.porosity, porosity_error=best.porosity - self.target, checked_at=finer, gap=best.gap,
            draw=best.candidate.draw, **reported_radii(best.made, radii_of(best.made)),
        )  # fmt: skip
        return best.made


def _points(field: ScalarField, n: int) -> Grid:
    """Points of equal weight in the whole field, n along an edge of the cell, fewer if that were too many."""
    # of a cell that repeats off its planes of symmetry, where lattices have layers of equal values: a level jumps there
    nx, ny, nz = field.cells
    n = max(4, min(n, round((MAX_SAMPLES / (nx * ny * nz)) ** (1 / 3))))
    centers = cell_centers(n, field.cells)
    if not field.periodic:
        return centers
    x, y, z = (share / n for share in OFF_SYMMETRY)
    return Grid((x, y, z), centers.spacing, centers.shape)


def _with_gap_option(recipe: Recipe) -> list[str]:
    """Stages of a recipe that sample an interior at a gap from its faces."""
    return [i for i, values in recipe.options().items() if "gap" in values and "clear_faces" in values]


def _with_gap(options: Options, samplers: list[str], gap: float) -> Options:
    """Options of a recipe with another gap, cell sizes; a copy."""
    changed = {i: dict(options.get(i, {})) for i in dict.fromkeys((*samplers, *options))}
    for i in samplers:
        changed[i]["gap"] = Length(gap, "cell")
    return changed


def _gaps(pores: PoreSet) -> tuple[float, float] | None:
    """Gaps between which is searched: from the spacing to where the box is packed to `FULL`; None if it is fuller."""
    from sppm_pipeline.method.sampling.capacity import box_capacity

    spacing = pores.spacing
    if not pores.has_faces or spacing is None:
        raise ConfigError("`by: gap` needs face pores with a spacing", hint="begin with `sample.mirrored_faces`")
    count = int((pores.piece == 0).sum())
    low, high = 0.0, 0.49
    for _ in range(50):  # bisection down to rounding
        middle = (low + high) / 2
        low, high = (middle, high) if FULL * box_capacity(1 - 2 * middle, spacing) >= count else (low, middle)
    return (spacing, low) if low > spacing else None
