"""``tune.stiffness``: from a target Young's modulus back to the design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import RecipeSize, Size
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import options
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.homogenization.stiffness.surrogate import parameter_for
from sppm_pipeline.stage import Context, Headline, Recipe, option
from sppm_pipeline.stages.homogenize.voxel import ElasticHomogenizer


@dataclass(frozen=True, kw_only=True)
class TuneStiffness(ElasticHomogenizer):
    """Find the structure whose Young's modulus is the target ("we can uniquely determine the structure at a target
    Young's modulus", paper, section 3.2).

    One option of the recipe is varied, the porosity that its `tune.porosity` or tile set aims at unless `vary` names
    another. A few values are homogenized first; a monotone curve through the logarithms of the moduli then proposes the
    next one, which is homogenized in turn, until the real modulus is within the tolerance of the target. All trials use
    the same random numbers, so that they differ by that option alone.

    The target is met on the grid of `resolution`; a last homogenization on a grid coarser by a third tells how far that
    is from the limit of fine grids: `modulus_grid_error` in the summary, with a warning if it exceeds `accuracy`.
    """

    name: ClassVar[str] = "tune.stiffness"
    reported: ClassVar[tuple[str, ...]] = (
        "value", "modulus", "modulus_error", "modulus_grid_error", "modulus_extrapolated", "homogenizations",
        "curve.#6.#2",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("modulus", error="modulus_grid_error"), Headline("modulus_extrapolated", "on fine grids"),
        Headline("value"), Headline("homogenizations"),
    )  # fmt: skip

    target: float = options.target(note="Young's modulus, in the unit of `young`", maximum=1e15)
    modulus: str = option(
        "isotropic", help="which modulus: of the nearest isotropic material, or along an axis",
        choices=("isotropic", "x", "y", "z"),
    )  # fmt: skip
    accuracy: float = option(0.01, help="largest relative error of the modulus", above=0, below=0.5)
    vary: str = option("", help="stage and option that is varied, as id.option; the recipe's target porosity if empty")
    low: float = option(0.3, help="smallest value of the varied option", minimum=-1e15, maximum=1e15)
    high: float = option(0.85, help="largest value of the varied option", minimum=-1e15, maximum=1e15)
    first: int = option(4, help="values that are homogenized before any is proposed", minimum=2, maximum=50)
    evaluations: int = options.evaluations(20, note="cells homogenized")

    def check_options(self) -> None:
        super().check_options()
        if not self.low < self.high:
            raise ConfigError(f"`low` is {self.low:g} and `high` {self.high:g}; they should rise")

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        """The first trials, and the two that usually follow; the porosity that is found is not known beforehand."""
        trials = self.first + 2
        made = recipe(palette, trials)
        # the grid coarser by a third, which tells the error, has 0.3 of the voxels
        return replace(self.solving(made, self.resolution, trials + 0.3), design=made.design)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Sample, propose, correct."""
        stage, varied = self._varied(recipe)
        trials: dict[float, tuple[float, ScalarField]] = {}

        def modulus_at(value: float) -> float:
            made = recipe.run(context, palette=context.palette, options={stage: {varied: value}})
            if not isinstance(made, ScalarField):
                raise ConfigError(f"the recipe {recipe.name!r} makes a {type(made).__name__}, no field")
            modulus = self._modulus(context, made, self.resolution)
            trials[value] = (modulus, made)
            context.progress(len(trials), self.evaluations, "homogenizations")
            return modulus

        for value in np.linspace(self.low, self.high, self.first):
            modulus_at(float(value))
        while True:
            best = min(trials, key=lambda value: abs(trials[value][0] / self.target - 1))
            error = trials[best][0] / self.target - 1
            if abs(error) <= self.accuracy:
                break
            if len(trials) >= self.evaluations:
                raise self._missed(f"after {len(trials)} homogenizations", best, trials)
            stiff = {value: modulus for value, (modulus, _) in trials.items() if modulus > 0}
            try:
                guess, (low, high) = parameter_for(np.array(list(stiff)), np.array(list(stiff.values())), self.target)
            except ValueError:
                raise self._missed(f"for {varied} from {self.low:g} to {self.high:g}", best, trials) from None
            # a guess on a known value would teach nothing
            room = 1e-3 * (high - low)
            if room <= 1e-12 * max(abs(low), abs(high)):
                raise self._missed(f"as the modulus jumps at {varied} = {guess:g}", best, trials)
            modulus_at(min(max(guess, low + room), high - room))
        on_grid = self._grid_error(context, *trials[best])
        context.report(
            varied=f"{stage}.{varied}",
            value=best,
            modulus=trials[best][0],
            modulus_error=error,
            **on_grid,
            homogenizations=len(trials),
            curve=[[value, trials[value][0]] for value in sorted(trials)],
        )
        return trials[best][1]

    def _modulus(self, context: Context, made: ScalarField, resolution: int) -> float:
        """The modulus that is tuned, of a field on a grid."""
        summary = replace(self, resolution=resolution).stiffness_of(context, made).summary()
        axis = "xyz".find(self.modulus)
        return float(summary["E"][axis] if axis >= 0 else summary["isotropic"]["E"])

    def _grid_error(self, context: Context, modulus: float, made: ScalarField) -> dict[str, float]:
        """What a grid coarser by a third tells of the result: error bar and limit of fine grids (Richardson)."""
        from sppm_pipeline.numerics.homogenization.stiffness.convergence import richardson

        coarse = max(2, round(self.resolution * 2 / 3))
        if coarse == self.resolution:
            return {}
        values = [np.array([self._modulus(context, made, coarse)]), np.array([modulus])]
        limit = richardson([1 / coarse, 1 / self.resolution], values)
        error, extrapolated = float(limit.error[0]), float(limit.value[0])
        if error > self.accuracy * self.target:
            context.warn(
                f"the modulus {modulus:.4g} is that of a grid of {self.resolution} voxels along the edge, whose error "
                f"bar is {error:.2g}, more than `accuracy` allows; finer grids tend to {extrapolated:.4g}: raise "
                "`resolution`"
            )
        return {"modulus_grid_error": error, "modulus_extrapolated": extrapolated}

    def _varied(self, recipe: Recipe) -> tuple[str, str]:
        options = recipe.options()
        if self.vary:
            stage, _, name = self.vary.rpartition(".")
            if stage not in options or name not in options[stage]:
                known = ", ".join(f"{i}.{name}" for i, values in options.items() for name in values)
                raise ConfigError(f"the recipe {recipe.name!r} has no option {self.vary!r}", hint=f"there are {known}")
            return stage, name
        found = [(i, name) for i, values in options.items() for name in ("target", "porosity") if name in values]
        if len(found) != 1:
            raise ConfigError(
                f"the recipe {recipe.name!r} has {len(found)} stages that aim at a porosity; one is tuned",
                hint="add a `tune.porosity` to the recipe, or name the option with `vary: id.option`",
            )
        return found[0]

    def _missed(self, why: str, best: float, trials: dict[float, tuple[float, ScalarField]]) -> DesignError:
        moduli = [modulus for modulus, _ in trials.values()]
        return DesignError(
            f"the modulus {self.target:g} was not met {why}: there are {min(moduli):.4g} to {max(moduli):.4g}; the "
            f"nearest is {trials[best][0]:.4g} at {best:g}",
            hint="widen `low` and `high`, or change the number of pores, which shifts the whole curve",
        )
