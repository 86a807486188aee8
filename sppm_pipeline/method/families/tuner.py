"""Base of stages that vary one option of a recipe until a number meets its target, and the words they share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.method.families import options
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.nouns.length import CELL_UNIT, Length
from sppm_pipeline.services.target_search import Search, search
from sppm_pipeline.stage import Context, Recipe, Stage, option

VARY, LOW, HIGH = "stage and option that is varied, as id.option", "smallest value of the varied option", (
    "largest value of the varied option"
)  # fmt: skip
LENGTHS = "lengths"
FIRST = "values that are tried before any is proposed"


class Varied(NamedTuple):
    """An option that is varied."""

    name: str  # as messages call it
    places: tuple[tuple[str, str], ...]  # stages and options of the recipe where it stands
    value: Any  # what the recipe states
    lengths: tuple[Length, ...] = ()  # those of the places, where `value` is their common factor

    @property
    def whole(self) -> bool:
        """True if it takes integers only."""
        return isinstance(self.value, int) and not isinstance(self.value, bool)

    def at(self, number: float) -> Any:
        """A value of the option: an integer, or a length in the unit that the recipe states."""
        if self.whole:
            return round(number)
        return Length(number, self.value.unit) if isinstance(self.value, Length) else number

    def within(self, low: float, high: float) -> tuple[float, float]:
        """The bounds between which it is varied; of integers the outermost ones that do not lie beyond.

        Raises ConfigError if there are no two.
        """
        if not self.whole:
            return low, high
        first, last = math.ceil(low), math.floor(high)
        if first >= last:
            raise ConfigError(
                f"{self.name!r} takes integers, and there are not two of them from {low:g} to {high:g}",
                hint="lower `low` or raise `high`",
            )
        return float(first), float(last)


def options_at(varied: Sequence[Varied], at: Sequence[float]) -> dict[str, dict[str, Any]]:
    """Options of a recipe, by stage, in which the varied ones have other values."""
    found: dict[str, dict[str, Any]] = {}
    for one, number in zip(varied, at, strict=True):
        values = [Length(number * a.value, a.unit) for a in one.lengths] or [one.at(number)] * len(one.places)
        for (stage, name), value in zip(one.places, values, strict=True):
            found.setdefault(stage, {})[name] = value
    return found


def periodic_cell(context: Context, recipe: Recipe, draw: int, options: dict[str, dict[str, Any]]) -> ScalarField:
    """The cell that a recipe draws with other options; ConfigError if it makes none that repeats."""
    made: Any = recipe.run(context, palette=context.palette, attempt=draw, options=options)
    if not isinstance(made, ScalarField) or not made.periodic:
        raise ConfigError(
            f"the recipe {recipe.name!r} makes a {type(made).__name__}; stiffness is that of a periodic cell",
            hint="end the recipe with a stage such as `field.walls`",
        )
    return made


def varied_option(recipe: Recipe, vary: str) -> Varied:
    """The option that a user names: ``id.option``, ``recipe.id.option``, or an option of all stages that state it; or
    `LENGTHS`, which are all lengths that the recipe states with a unit, by a common factor.

    Raises ConfigError if there is none, or stages state it differently.
    """
    known: Mapping[str, Mapping[str, Any]] = {**recipe.inner_options(), **recipe.options()}
    stage, _, name = vary.rpartition(".")
    if stage in known and name in known[stage]:
        return Varied(vary, ((stage, name),), known[stage][name])
    if vary == LENGTHS:
        sizes = {(id_, name): a for id_, values in known.items() for name, a in values.items() if _physical(a)}
        if not sizes:
            raise ConfigError(
                f"the recipe {recipe.name!r} states no length with a unit", hint="give its cell a size, as `edge: 4 mm`"
            )
        return Varied(vary, tuple(sizes), 1.0, tuple(sizes.values()))
    if not stage:
        found = {id_: values[vary] for id_, values in known.items() if values.get(vary) is not None}
        if found and all(value == next(iter(found.values())) for value in found.values()):
            return Varied(vary, tuple((id_, vary) for id_ in found), next(iter(found.values())))
        if found:
            stated = ", ".join(f"{id_}.{vary}" for id_ in found)
            raise ConfigError(
                f"stages of the recipe {recipe.name!r} state different values of {vary!r}", hint=f"name one of {stated}"
            )
    there = ", ".join(f"{i}.{name}" for i, values in known.items() for name in values)
    raise ConfigError(f"the recipe {recipe.name!r} has no option {vary!r}", hint=f"there are {there}")


def _physical(value: Any) -> bool:
    return isinstance(value, Length) and value.unit not in (None, CELL_UNIT)


@dataclass(frozen=True, kw_only=True)
class Tuner(Stage):
    """Options of a search by few and costly evaluations, and the search."""

    vary: str = option("", help=f"{VARY}; the recipe's target porosity if empty")
    low: float = option(0.3, help=LOW, minimum=-1e15, maximum=1e15)
    high: float = option(0.85, help=HIGH, minimum=-1e15, maximum=1e15)
    first: int = option(4, help=FIRST, minimum=2, maximum=50)
    evaluations: int = options.evaluations(20)

    def check_range(self) -> None:
        """A range to search."""
        if not self.low < self.high:
            raise ConfigError(f"`low` is {self.low:g} and `high` {self.high:g}; they should rise")

    def met(
        self, context: Context, recipe: Recipe, target: float, accuracy: float,
        number_of: Callable[[ScalarField], float], *, what: tuple[str, str],
        counted: tuple[str, str], more: Callable[[float, ScalarField], Mapping[str, Any]] = lambda number, made: {},
    ) -> ScalarField:  # fmt: skip
        """Try values of the varied option, all with the same random numbers, until the number is `target` within the
        relative `accuracy`, and report; `DesignError` if it is not met.

        `number_of` gives the number of what the recipe makes, positive, or 0 where there is none; `what` and `counted`
        are names in the summary and words of the number and of the evaluations; `more` gives what else is reported of
        the number and the field that were found.
        """
        varied = varied_option(recipe, self.vary) if self.vary else _porosity_of(recipe)
        low, high = varied.within(self.low, self.high)
        fields: dict[float, ScalarField] = {}

        def evaluate(at: Sequence[float]) -> tuple[float]:
            # the context's own random numbers: trials differ by the option alone
            made = recipe.run(context, palette=context.palette, options=options_at([varied], at))
            if not isinstance(made, ScalarField):
                raise ConfigError(f"the recipe {recipe.name!r} makes a {type(made).__name__}, no field")
            fields[at[0]] = made
            number = number_of(made)
            context.progress(len(fields), self.evaluations, counted[1])
            return (number,)

        found = search(
            evaluate, [low], [high], [target], accuracy, first=self.first, evaluations=self.evaluations,
            whole=[varied.whole],
        )  # fmt: skip
        if not found.met:
            raise missed(found, [f"the {what[1]}"], [target], [varied.name], [low], [high], counted[1])
        curve = sorted([trial.at[0], trial.numbers[0]] for trial in found.trials if trial.numbers is not None)
        (value,), numbers = found.best
        assert numbers is not None
        name, number, made = what[0], numbers[0], fields[value]
        context.report(
            varied=".".join(varied.places[0]) if len(varied.places) == 1 else varied.name, value=value,
            **{name: number, f"{name}_error": number / target - 1}, **more(number, made), **{counted[0]: len(curve)},
            curve=curve,
        )  # fmt: skip
        return made


def _porosity_of(recipe: Recipe) -> Varied:
    """The only target porosity in a recipe."""
    found = [
        Varied(name, ((i, name),), values[name])
        for i, values in recipe.options().items()
        for name in ("target", "porosity")
        if name in values
    ]
    if len(found) != 1:
        raise ConfigError(
            f"the recipe {recipe.name!r} has {len(found)} stages that aim at a porosity; one is tuned",
            hint="add a `tune.porosity` to the recipe, or name the option with `vary: id.option`",
        )
    return found[0]


def missed(
    found: Search, what: Sequence[str], targets: Sequence[float], varied: Sequence[str], low: Sequence[float],
    high: Sequence[float], evaluations: str, spread: Sequence[str] = ("", ""),
) -> DesignError:  # fmt: skip
    """The error of a search that did not meet its targets: what was reached, where, and what stopped it.

    `what` has the `targets`; `varied`, `low` and `high` are one each for each of these. `evaluations` says what those
    are, in the plural; `spread` is said behind each number that was reached.
    """
    goal = " and ".join(f"{name} {target:g}" for name, target in zip(what, targets, strict=True))
    best = found.best.numbers or ()
    known = [trial.numbers for trial in found.trials if trial.numbers is not None]
    ends = [f"{min(n[i] for n in known):.4g} to {max(n[i] for n in known):.4g}" for i in range(len(what))]
    sides = [
        "low" if at - a <= 1e-6 * (b - a) else "high" if b - at <= 1e-6 * (b - a) else ""
        for at, a, b in zip(found.best.at, low, high, strict=True)
    ]
    reached = " and ".join(f"{number:.4g}{more}" for number, more in zip(best, spread, strict=False))
    place = " and ".join(
        f"{name} = {at:g}" + (f", the bound `{side}`" if side else "")
        for name, at, side in zip(varied, found.best.at, sides, strict=True)
    )
    nearest = f"the nearest {'is' if len(what) == 1 else 'are'} {reached} at {place}"
    if found.why == "exhausted":
        return DesignError(
            f"{goal} {'was' if len(what) == 1 else 'were'} not met after {len(found.trials)} {evaluations}; {nearest}",
            hint="raise `evaluations` or `accuracy`",
        )
    if found.why == "jump":
        (x0, y0), (x1, y1) = _around(found, targets[0])
        return DesignError(
            f"{goal} is not reachable: from {varied[0]} = {x0:.6g} to {x1:.6g} it jumps from {y0:.4g} to {y1:.4g}",
            hint="vary an option that changes it smoothly, or take the mean of more draws",
        )
    ranges = " and ".join(f"{n} from {a:g} to {b:g}" for n, a, b in zip(varied, low, high, strict=True))
    together = "is not reachable" if len(what) == 1 else "are not reachable together"
    widen = " and ".join(f"`{side}` of {name}" for name, side in zip(varied, sides, strict=True) if side)
    return DesignError(
        f"{goal} {together} for {ranges}: there are {' and '.join(ends)}; {nearest}",
        hint=f"move {widen} on, or change another option, such as the number of pores" if widen
        else "no bound stops it, as the best lies inside: change another option, such as the number of pores",
    )  # fmt: skip


def _around(found: Search, target: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """The nearest two trials that enclose a target."""
    known = sorted((trial.at[0], trial.numbers[0]) for trial in found.trials if trial.numbers is not None)
    pairs = [pair for pair in pairwise(known) if (pair[0][1] - target) * (pair[1][1] - target) <= 0]
    # the narrowest interval shows the jump best
    return min(pairs, key=lambda pair: pair[1][0] - pair[0][0])
