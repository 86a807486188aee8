"""``tune.porosity``: find the number of pores, then the level or the gap, for a target porosity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import (
    ConfigError,
    Context,
    DesignError,
    Length,
    Microstructure,
    Palette,
    Recipe,
    RecipeSize,
    ScalarField,
    Size,
    Stage,
    option,
    options,
)
from sppm_pipeline.services.grid import Grid, cell_centers

Options = dict[str, dict[str, Any]]

OFF_SYMMETRY = (0.3090, 0.7236, 0.1459)
"""Where the first point lies, as fractions of the distance of points."""

LARGEST = 1.5e8
"""Most samples of a field at once; a single cell of 512 voxels along its edge has as many."""


@dataclass(frozen=True, kw_only=True)
class TunePorosity(Stage):
    """Reach a porosity within 0.001 of the volume (paper, section "Porosity Control").

    First the number of pores n: a straight line through the porosities of trial cells gives the n for the target, at
    constant packing. Then fine: the level is set to the quantile of the field, which reaches any target in one pass,
    or, as in the paper, the gap d between faces and interior is searched, on the branch d >= spacing where porosity
    falls with d. The result is checked on an independent, finer grid.

    A recipe that makes any other field is tuned by level: the field is cut at its quantile, which such a field may call
    a strut radius or a wall thickness.
    """

    name: ClassVar[str] = "tune.porosity"
    reported: ClassVar[tuple[str, ...]] = (
        "count", "line.slope", "line.intercept", "line.r_squared", "line.residual_sd", "line.largest_residual",
        "line.n_min", "line.n_max", "line.samples", "porosity", "porosity_error", "checked_at", "level",
        "gap_evaluations", "gap",
    )  # fmt: skip

    target: float = options.target(note="the porosity", below=1)
    by: str = option("level", help="what is tuned at last", choices=("level", "gap"))
    fit_count: bool = option(
        False, help="choose the number of pores by a fitted line; the recipe's stages then need `total`"
    )
    trials: int = options.trials(3, note="on the line", formerly="samples")
    resolution: int = options.resolution(64, minimum=8, maximum=512)
    tolerance: float = options.tolerance(0.001)
    evaluations: int = options.evaluations(40, note="cells drawn while the gap is searched")

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        n, trials = self.resolution, 8 * self.trials if self.fit_count else 0
        draws = self.evaluations // 3 if self.by == "gap" else 1
        made = recipe(palette, trials + draws)
        grids = [(trials, made.grid(max(24, n // 2))), (draws, made.grid(n)), (draws, made.grid(n + n // 2 + 1))]
        return made.at_porosity(
            self.target,
            samples=sum(times * grid.samples for times, grid in grids),
            sums=sum(times * grid.sums for times, grid in grids),
            resident=grids[-1][1].resident,
        )

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Tune the recipe."""
        options: Options = {}
        if self.fit_count:
            options = self._fitted_count(context, recipe)
        if self.by == "gap":
            return self._by_gap(context, recipe, options)
        return self._by_level(context, recipe, options)

    def _porosity(self, context: Context, field: ScalarField, n: int) -> float:
        return float((field.sample(_points(field, n), context.threads) >= 0).mean())

    def _draw(self, context: Context, recipe: Recipe, options: Mapping[str, Mapping[str, Any]]) -> ScalarField:
        made = recipe.run(context, palette=context.palette, options=options)
        if not isinstance(made, ScalarField):
            raise ConfigError(
                f"the recipe {recipe.name!r} makes a {type(made).__name__}; tuning needs a field",
                hint="end the recipe with a stage such as `field.gaussian`",
            )
        return made

    def _draw_pores(self, context: Context, recipe: Recipe, options: Mapping[str, Mapping[str, Any]]) -> Microstructure:
        made = self._draw(context, recipe, options)
        if not isinstance(made, Microstructure):
            raise ConfigError(
                f"the recipe {recipe.name!r} makes a {type(made).__name__}; the gap is one between pores",
                hint="end the recipe with `field.gaussian`, or tune `by: level`",
            )
        return made

    def _fitted_count(self, context: Context, recipe: Recipe) -> Options:
        """The number of pores at which the fitted line meets the target, as options of the recipe."""
        from sppm_pipeline.method.porosity.line import count_for_porosity, fit_line

        stages = [i for i, values in recipe.options().items() if values.get("total") is not None]
        if not stages:
            raise ConfigError(
                "`fit_count` needs stages with the option `total`",
                hint="give the samplers of the recipe `total: 100` and `share: 0.5` instead of `count`",
            )
        start = int(recipe.options()[stages[0]]["total"])
        coarse = max(24, self.resolution // 2)
        counts: list[int] = []
        porosities: list[float] = []

        def probe(n: int) -> None:
            for sample in range(self.trials):
                cell = recipe.run(
                    context,
                    palette=context.palette,
                    attempt=1 + sample,
                    options={stage: {"total": n} for stage in stages},
                )
                counts.append(n)
                porosities.append(self._porosity(context, cell, coarse))

        for factor in (0.5, 0.75, 1.0, 1.5, 2.0):
            probe(max(4, round(start * factor)))
        for _ in range(6):  # the line is trusted only between its points
            low, high = min(porosities), max(porosities)
            if low <= self.target <= high:
                break
            probe(max(4, min(counts) // 2) if self.target < low else max(counts) * 3 // 2)
        # far from the target porosity saturates and bends the line away
        order = np.unique(counts)
        mean = np.array([np.mean([p for n, p in zip(counts, porosities, strict=True) if n == c]) for c in order])
        used = np.isin(counts, order[np.argsort(np.abs(mean - self.target), kind="stable")[:3]])
        line = fit_line(np.array(counts)[used], np.array(porosities)[used])
        n = count_for_porosity(line, self.target)
        context.report(count=n, line={name: value for name, value in line._asdict().items() if name != "residuals"})
        return {stage: {"total": n} for stage in stages}

    def _by_level(self, context: Context, recipe: Recipe, options: Options) -> ScalarField:
        field = self._draw(context, recipe, options)
        n = self.resolution
        error = np.inf
        for _ in range(3):  # the porosity of a coarse grid is off by its voxels at the surface
            field = self._cut(context, field, n)
            finer = n + n // 2 + 1
            reached = self._porosity(context, field, finer)
            error = reached - self.target
            if abs(error) <= self.tolerance:
                level = {"level": field.level} if isinstance(field, Microstructure) else {}
                context.report(porosity=reached, porosity_error=error, checked_at=finer, **level)
                return field
            n = finer
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

    def _by_gap(self, context: Context, recipe: Recipe, options: Options) -> Microstructure:
        from sppm_pipeline.method.porosity.level import search_monotone

        found: dict[float, Microstructure] = {}
        samplers = [i for i, values in recipe.options().items() if "gap" in values and "clear_faces" in values]
        if not samplers:
            raise ConfigError(
                "`by: gap` needs a sampler with the option `gap` in the recipe", hint="use `sample.dart_throwing`"
            )
        first = self._draw_pores(context, recipe, options)
        spacing = first.graph.pores.spacing
        if not first.graph.pores.has_faces or spacing is None:
            raise ConfigError("`by: gap` needs face pores with a spacing", hint="begin with `sample.mirrored_faces`")
        finer = self.resolution + self.resolution // 2 + 1
        high = _widest_gap(int((first.graph.pores.piece == 0).sum()), spacing)
        if high <= spacing:
            raise DesignError(
                f"the interior is too full to make the gap wider than the spacing of {spacing:g} cell sizes",
                hint="give fewer pores or a smaller spacing, or tune `by: level`",
            )

        def reached(gap: float) -> float:
            changed = {i: dict(options.get(i, {})) for i in {*samplers, *options}}
            for i in samplers:
                changed[i]["gap"] = Length(gap, "cell")
            found[gap] = self._draw_pores(context, recipe, changed)
            context.progress(len(found), self.evaluations, "gaps tried")
            return self._porosity(context, found[gap], finer)

        result = search_monotone(reached, spacing, high, self.target, self.tolerance, self.evaluations)
        context.report(gap_evaluations=result.evaluations)
        if not result.met:
            raise DesignError(
                f"no gap between {spacing:.4g} and {high:.4g} cell sizes gives the porosity {self.target:g}; the best "
                f"is the gap {result.x:g} with {result.value:.5f}",
                hint="change the number of pores (`fit_count: true`), or tune `by: level`",
            )
        context.report(porosity=result.value, porosity_error=result.value - self.target, gap=result.x)
        return found[result.x]


def _points(field: ScalarField, n: int) -> Grid:
    """Points of equal weight in the whole field, n along an edge of the cell, fewer if that were too many.

    Those of a field that repeats lie off the planes of symmetry of the cell: lattices have whole layers of equal values
    there, so that a level could only jump over them.
    """
    nx, ny, nz = field.cells
    n = max(4, min(n, round((LARGEST / (nx * ny * nz)) ** (1 / 3))))
    centers = cell_centers(n, field.cells)
    if not field.periodic:
        return centers
    x, y, z = (share / n for share in OFF_SYMMETRY)
    return Grid((x, y, z), centers.spacing, centers.shape)


def _widest_gap(count: int, spacing: float) -> float:
    """The gap at which the interior box is packed to 85 % of its limit; beyond it drawing becomes a matter of luck."""
    from sppm_pipeline.method.sampling.capacity import box_capacity

    low, high = 0.0, 0.49
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if 0.85 * box_capacity(1 - 2 * middle, spacing) >= count else (low, middle)
    return low
