"""``tune.property``: from target properties, of any kind, back to the design."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Palette, Recipe, RecipeSize, ScalarField, Size, Stage, option, options
from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families.tuner import FIRST, HIGH, LOW, VARY, missed, options_at, varied_option
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.target_search import relative_error, search
from sppm_pipeline.stage import Observed

Numbers = float | tuple[float, float]
Words = str | tuple[str, str]
Point = tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class TuneProperty(Stage):
    """Find the structure that has a property, or two: any number that a stage reports, over any option of a recipe.

    The recipe makes a structure and measures it, as a pipeline would; the structure is what comes out. `of` names a
    number of its stages as columns of sweeps are named: ``flow.darcy_mean``, ``elastic.E.1``, ``sizes.solid.mean``.
    `vary` names the option: ``id.option``; ``recipe.id.option`` in a recipe that the recipe repeats; or an option
    alone, which then changes in all stages that state it; or ``lengths``, a common factor of all lengths that the
    recipe states with a unit, at which shapes stay. Two numbers take two options: `of`, `target`, `vary`, `low` and
    `high` are then lists of two.

    A few values are tried first; further ones are proposed until the number is within `accuracy` of its target. With
    more than one of `draws` the mean is tuned, over draws that are the same for all values; the summary holds the
    standard deviation, and the draw nearest to the target comes out. A draw that fails or is rejected is left out. If
    the target can't be reached, the error names the nearest that can, where, and which bound is in the way.

    Each run of the recipe is kept in the cache, so that another target, or more draws, begin with what is known.
    """

    name: ClassVar[str] = "tune.property"
    returns: ClassVar[type | None] = ScalarField
    reported: ClassVar[tuple[str, ...]] = (
        "value", "value.#2", "reached", "reached.#2", "error", "error.#2", "deviation", "deviation.#2",
        "chosen", "chosen.#2", "draw", "failed", "evaluations", "curve.#6.#4",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("reached", error="deviation"), Headline("value"), Headline("chosen", "of the draw taken"),
        Headline("evaluations"),
    )  # fmt: skip

    of: Words = option(help="number of a stage of the recipe that has the target, as id.number; or two")
    target: Numbers = options.target(note="of one number, or of two", above=None, minimum=-1e15, maximum=1e15)
    vary: Words = option(help=f"{VARY}; two of them for two targets")
    low: Numbers = option(help=LOW, minimum=-1e15, maximum=1e15)
    high: Numbers = option(help=HIGH, minimum=-1e15, maximum=1e15)
    draws: int = options.draws(1, note="whose mean is tuned", maximum=1000)
    accuracy: float = options.accuracy(0.02, note="of a target 0, relative to the largest of the first values")
    first: int = option(3, help=f"{FIRST}; along each of two options", minimum=2, maximum=50)
    evaluations: int = options.evaluations(30, note="values of the options, each with all draws")

    def check_options(self) -> None:
        """As many targets as numbers and options, and ranges that rise."""
        count = len(_each(self.of))
        for name in ("target", "vary", "low", "high"):
            if (found := len(_each(getattr(self, name)))) != count:
                raise ConfigError(
                    f"`of` holds {count} and `{name}` {found}; each number has a target, and an option with its bounds",
                    hint="for instance of: [flow.darcy_mean, elastic.E.1], target: [900, 0.1], vary: [porous.target, "
                    "total], low: [0.5, 40], high: [0.9, 160]",
                )
        for low, high in zip(_each(self.low), _each(self.high), strict=True):
            if not low < high:
                raise ConfigError(f"`low` is {low:g} and `high` {high:g}; they should rise")
        if len({*_each(self.of)}) < count or len({*_each(self.vary)}) < count:
            raise ConfigError("two numbers and two options are wanted, and one is named twice")
        if self.first**count > self.evaluations:
            raise ConfigError(
                f"`first: {self.first}` takes {self.first**count} evaluations, more than `evaluations: "
                f"{self.evaluations}`", hint="lower `first` or raise `evaluations`",
            )  # fmt: skip

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        """The first values, and those that usually follow: two for one target, five for two."""
        count = len(_each(self.of))
        made = recipe(palette, self.draws * (self.first**count + (2 if count == 1 else 5)))
        return Size(design=made.design, geometry=made.geometry)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Try, propose, correct; then make the draw that is nearest."""
        names = [recipe.number(name) for name in _each(self.of)]
        varied = [varied_option(recipe, name) for name in _each(self.vary)]
        targets = _each(self.target)
        bounds = [one.within(*of) for one, *of in zip(varied, _each(self.low), _each(self.high), strict=True)]
        low, high = [a for a, _ in bounds], [b for _, b in bounds]
        drawn: dict[Point, dict[int, list[float]]] = {}
        failures: list[str] = []
        missing: set[str] = set()
        last: tuple[Point, int, Observed] | None = None

        def observe(at: Point, draw: int, again: bool = False) -> Observed:
            nonlocal last
            seen = recipe.observe(context, ScalarField, attempt=draw, options=options_at(varied, at), again=again)
            last = (at, draw, seen)
            return seen

        def evaluate(at: Point) -> list[float] | None:
            drawn[at] = {}
            for draw in range(self.draws):
                try:
                    numbers = observe(at, draw).numbers
                except DesignError as error:
                    failures.append(f"{error.message}, at {_place(self.vary, at)}")
                else:
                    if all(name in numbers for name in names):
                        drawn[at][draw] = [float(numbers[name]) for name in names]
                    missing.update(name for name in names if name not in numbers)
                context.progress(self.draws * (len(drawn) - 1) + draw + 1, self.draws * self.evaluations, "draws")
            return _mean(drawn[at]).tolist() if drawn[at] else None

        try:
            found = search(
                evaluate, low, high, targets, self.accuracy, first=self.first, evaluations=self.evaluations,
                whole=[one.whole for one in varied],
            )  # fmt: skip
        except ValueError:
            why = failures[0] if failures else f"no run of the recipe reports {' and '.join(sorted(missing))}"
            raise DesignError(
                f"no value of {' and '.join(_each(self.vary))} gives {' and '.join(names)}: {why}",
                hint=None if failures else "it may be a number that needs a physical `cell` size, or more voxels",
            ) from None
        for reason in dict.fromkeys(failures):
            context.warn(f"left out: {reason}")
        at = found.best.at
        deviation = _deviation(drawn[at])
        if not found.met:
            quoted = [f"`{name}`" for name in names]
            spread = ["" if s is None else f" +- {s:.2g}" for s in deviation]
            raise missed(found, quoted, targets, _each(self.vary), low, high, "evaluations", spread)
        reached = _mean(drawn[at]).tolist()
        draw = min(drawn[at], key=lambda k: _error(drawn[at][k], targets, reached))
        if last is None or last[:2] != (at, draw) or last[2].made is None:
            observe(at, draw, again=True)
        assert last is not None
        self._warn_of_spread(context, names, targets, deviation, len(drawn[at]))
        context.report(
            of=_as(names), varied=_as(list(_each(self.vary))), value=_as(list(at)), reached=_as(reached),
            error=_as([n / t - 1 if t else n for n, t in zip(reached, targets, strict=True)]),
            deviation=_as(deviation), chosen=_as(drawn[at][draw]), draw=draw, failed=len(failures),
            evaluations=len(found.trials),
            curve=[[*trial.at, *trial.numbers] for trial in sorted(found.trials) if trial.numbers is not None],
        )  # fmt: skip
        return last[2].made

    def _warn_of_spread(
        self, context: Context, names: Sequence[str], targets: Sequence[float], deviation: Sequence[float | None],
        count: int,
    ) -> None:  # fmt: skip
        for name, target, s in zip(names, targets, deviation, strict=True):
            error = 0.0 if s is None else s / math.sqrt(count)
            allowed = self.accuracy * abs(target)
            if target and error > allowed:
                context.warn(
                    f"the mean of `{name}` over {count} draws is known to +- {error:.2g} (standard error), more than "
                    f"`accuracy` asks for; about {math.ceil((error / allowed) ** 2 * count)} draws would do"
                )


def _each(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def _as(values: list[Any]) -> Any:
    """One for one target, a list for two, as they were asked for."""
    return values[0] if len(values) == 1 else values


def _place(vary: Words, at: Point) -> str:
    return " and ".join(f"{name} = {number:g}" for name, number in zip(_each(vary), at, strict=True))


def _mean(drawn: dict[int, list[float]]) -> F64:
    return np.asarray(np.array(list(drawn.values()), np.float64).mean(0), np.float64)


def _deviation(drawn: dict[int, list[float]]) -> list[float | None]:
    """Sample standard deviations over the draws; None for a single one."""
    values = np.array(list(drawn.values()), np.float64)
    return values.std(0, ddof=1).tolist() if len(values) > 1 else [None] * values.shape[1]


def _error(numbers: Sequence[float], targets: Sequence[float], scales: Sequence[float]) -> float:
    return max(relative_error(n, t, abs(s)) for n, t, s in zip(numbers, targets, scales, strict=True))
