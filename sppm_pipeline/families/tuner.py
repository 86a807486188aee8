"""Base of stages that vary one option of a recipe until a number meets its target."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.families import options
from sppm_pipeline.fields.scalar_field import ScalarField
from sppm_pipeline.numerics.homogenization.stiffness.surrogate import parameter_for
from sppm_pipeline.stage import Context, Recipe, Stage, option


class Met(NamedTuple):
    """What a search has found.

    Attributes
    ----------
    varied : str
        Stage and option, as id.option.
    value : float
        Of the option.
    number : float
        What was tuned, at that value.
    made : ScalarField
    curve : list of [value, number]
        All trials, by value.
    """

    varied: str
    value: float
    number: float
    made: ScalarField
    curve: list[list[float]]


@dataclass(frozen=True, kw_only=True)
class Tuner(Stage):
    """Options of a search by few and costly evaluations, and the search."""

    vary: str = option("", help="stage and option that is varied, as id.option; the recipe's target porosity if empty")
    low: float = option(0.3, help="smallest value of the varied option", minimum=-1e15, maximum=1e15)
    high: float = option(0.85, help="largest value of the varied option", minimum=-1e15, maximum=1e15)
    first: int = option(4, help="values that are tried before any is proposed", minimum=2, maximum=50)
    evaluations: int = options.evaluations(20)

    def check_range(self) -> None:
        """A range to search."""
        if not self.low < self.high:
            raise ConfigError(f"`low` is {self.low:g} and `high` {self.high:g}; they should rise")

    def met(
        self, context: Context, recipe: Recipe, target: float, accuracy: float,
        number_of: Callable[[ScalarField], float], words: tuple[str, str],
    ) -> Met:  # fmt: skip
        """Sample, propose by a monotone curve through the logarithms, correct.

        Parameters
        ----------
        context, recipe
            All trials use the same random numbers.
        target, accuracy : float
            The number, and its largest relative error.
        number_of : callable
            From what the recipe makes to the number; positive, or 0 where there is none.
        words : (what is tuned, what an evaluation is)

        Raises
        ------
        DesignError
            If the target is not met.
        """
        stage, varied = self._varied(recipe)
        trials: dict[float, tuple[float, ScalarField]] = {}

        def try_out(value: float) -> None:
            made = recipe.run(context, palette=context.palette, options={stage: {varied: value}})
            if not isinstance(made, ScalarField):
                raise ConfigError(f"the recipe {recipe.name!r} makes a {type(made).__name__}, no field")
            trials[value] = (number_of(made), made)
            context.progress(len(trials), self.evaluations, words[1])

        for value in np.linspace(self.low, self.high, self.first):
            try_out(float(value))
        while True:
            best = min(trials, key=lambda value: abs(trials[value][0] / target - 1))
            if abs(trials[best][0] / target - 1) <= accuracy:
                break
            if len(trials) >= self.evaluations:
                raise _missed(f"after {len(trials)} {words[1]}", words[0], target, best, trials)
            positive = {value: number for value, (number, _) in trials.items() if number > 0}
            try:
                guess, (low, high) = parameter_for(np.array(list(positive)), np.array(list(positive.values())), target)
            except ValueError:
                why = f"for {varied} from {self.low:g} to {self.high:g}"
                raise _missed(why, words[0], target, best, trials) from None
            # a guess on a known value would teach nothing
            room = 1e-3 * (high - low)
            if room <= 1e-12 * max(abs(low), abs(high)):
                raise _missed(f"as the {words[0]} jumps at {varied} = {guess:g}", words[0], target, best, trials)
            try_out(min(max(guess, low + room), high - room))
        curve = [[value, trials[value][0]] for value in sorted(trials)]
        return Met(f"{stage}.{varied}", best, *trials[best], curve)

    def _varied(self, recipe: Recipe) -> tuple[str, str]:
        known: Mapping[str, Mapping[str, Any]] = recipe.options()
        if self.vary:
            stage, _, name = self.vary.rpartition(".")
            if stage not in known or name not in known[stage]:
                there = ", ".join(f"{i}.{name}" for i, values in known.items() for name in values)
                raise ConfigError(f"the recipe {recipe.name!r} has no option {self.vary!r}", hint=f"there are {there}")
            return stage, name
        found = [(i, name) for i, values in known.items() for name in ("target", "porosity") if name in values]
        if len(found) != 1:
            raise ConfigError(
                f"the recipe {recipe.name!r} has {len(found)} stages that aim at a porosity; one is tuned",
                hint="add a `tune.porosity` to the recipe, or name the option with `vary: id.option`",
            )
        return found[0]


def _missed(
    why: str, what: str, target: float, best: float, trials: Mapping[float, tuple[float, ScalarField]]
) -> DesignError:
    numbers = [number for number, _ in trials.values()]
    return DesignError(
        f"the {what} {target:g} was not met {why}: there are {min(numbers):.4g} to {max(numbers):.4g}; the "
        f"nearest is {trials[best][0]:.4g} at {best:g}",
        hint="widen `low` and `high`, or change the number of pores, which shifts the whole curve",
    )
