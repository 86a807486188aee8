"""Estimating what a plan will take, stage by stage along the wiring, and refusing what can't fit."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from sppm_pipeline.engine.plan.kernels import MIN_SECONDS_AHEAD, SWITCH, has_compiled, missing_of
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.wiring import Step, last_uses, makes_kind
from sppm_pipeline.engine.process.budget import allowed_memory, format_bytes, free_disk
from sppm_pipeline.errors import ConfigError, ResourceError, SppmError, described
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.report import Report
from sppm_pipeline.nouns.size import ONE, RecipeSize, Size, sum_of
from sppm_pipeline.services.jit.kernel_cache import is_kept
from sppm_pipeline.stage import Stage

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store

TABLE = Path(__file__).with_name("rates.json")
"""For each stage by name (for writers by format), seconds on one core, bytes of memory while it runs, bytes that its
result keeps, and bytes on disk; each for a run (unit ``1``) and for units of `Size`. ``benchmarks/rates.py`` corrects
it by runs of the configurations; each run does so for its machine, with the cache."""

HISTORY = "history.json"
"""File of a cache with what stages took on its machine."""

MAX_SEEN = 12
"""Runs of a stage that are remembered, the latest. More would distinguish more sizes; twelve of each of a hundred
stages make a file of 100 kB, which is read in a millisecond."""

SAME = 1.05
"""Factor between sizes up to which runs are of the same size: the latest counts."""

MARGIN = 1.03
"""Factor by which the memory of the same run differs between two times: 0.2 to 1.2 % in those that were repeated."""


class Seen(NamedTuple):
    """A stage that ran on this machine: seconds and bytes of the process, by the table and as they were."""

    rated: float
    seconds: float
    expected: float
    peak: float  # 0 where it is unknown


History = Mapping[str, Sequence[Seen]]
"""For each entry of the table what was seen, the latest last."""


class Cost(NamedTuple):
    """Seconds on one core; bytes while a stage runs, of its result, and on disk."""

    seconds: float
    memory: float
    kept: float
    disk: float


@functools.cache
def table() -> Mapping[str, Mapping[str, Mapping[str, float]]]:
    """Stage -> column -> unit -> rate."""
    found: dict[str, dict[str, dict[str, float]]] = json.loads(TABLE.read_text(encoding="utf-8"))
    return found


def cost(name: str, units: Mapping[str, float]) -> Cost | None:
    """The cost of a stage of this size by the table; None if it has no entry."""
    if name not in table():
        return None
    totals = (
        sum(rate * (1.0 if unit == "1" else units.get(unit, 0.0)) for unit, rate in table()[name][column].items())
        for column in Cost._fields
    )
    return Cost(*totals)


def by_history(seen: Sequence[Seen], rated: float, expected: float) -> tuple[float, float]:
    """Seconds of a stage and bytes of its process, in proportion to the runs that were nearest in size; those by the
    table, `rated` and `expected`, if there are none.
    """
    time = _nearest([(one.rated, one.seconds) for one in seen], rated)
    memory = _nearest([(one.expected, one.peak) for one in seen if one.peak], expected)
    return (
        rated if time is None else rated * time[1] / time[0],
        expected if memory is None else expected * MARGIN * memory[1] / memory[0],
    )


def _nearest(seen: Sequence[tuple[float, float]], size: float) -> tuple[float, float] | None:
    """The pair whose first number is nearest to `size`; of those that are as near, the latest."""

    def distance(pair: tuple[float, float]) -> float:
        return max(math.log(SAME), abs(math.log(max(pair[0], 1e-9) / max(size, 1e-9))))

    return min(reversed([pair for pair in seen if pair[0] > 0]), key=distance, default=None)


def history_of(store: Store | None) -> dict[str, list[Seen]]:
    """Runs of stages that a cache remembers of its machine."""
    found = ((store.read_text(HISTORY) if store is not None else None) or {}).get("stages", {})
    return {name: [Seen(*numbers) for numbers in runs] for name, runs in found.items()}


def remember(store: Store, took: Iterable[tuple[str, Seen]]) -> None:
    """Remember with a cache what stages took; nothing is written if that says nothing new."""
    history = history_of(store)
    news = [(name, seen) for name, seen in took if not _is_known(history.get(name, ()), seen)]
    for name, seen in news:
        # four digits keep the file small and are more than a time is reproducible to
        history[name] = [*history.get(name, ()), Seen(*(float(f"{number:.4g}") for number in seen))][-MAX_SEEN:]
    if news:
        with contextlib.suppress(OSError):  # a full disk: the next estimate is as good as this one
            store.write_text(HISTORY, {"stages": {name: [list(one) for one in runs] for name, runs in history.items()}})


def _is_known(runs: Sequence[Seen], seen: Seen) -> bool:
    """True if the last run of this size took the same, up to noise."""
    near = [one for one in runs if max(one.rated, seen.rated) <= SAME * min(one.rated, seen.rated)]
    # 10 % or 0.05 s of time and 1 % of memory are noise of a machine that does other work as well
    return bool(near) and (
        abs(near[-1].seconds - seen.seconds) < max(0.05, 0.1 * seen.seconds)
        and abs(near[-1].peak - seen.peak) < 0.01 * seen.peak
    )


MAX_OVERESTIMATE = 1.3
"""Estimates are up to this much too high, so that a run is refused only beyond it."""

COMPILER = Cost(seconds=0.0, memory=155e6, kept=0.0, disk=0.0)
"""Numba and LLVM in a process: first runs of seven configurations took 79 to 155 MB more than later ones."""

LEFT_BY_ROWS = 25e6
"""Bytes that the allocator keeps after a row of a sweep: 12 and 17 MB in sweeps of 15 and 22 rows."""

RecipeSteps = Mapping[str, Sequence[Step]]

NONE_SEEN: History = {}


@dataclass(frozen=True)
class StageEstimate:
    """One stage of a plan."""

    step: Step
    size: Size | None  # None if it is unknown
    cost: Cost | None  # with those of its recipes; None if the size or the rates are unknown
    rated: float  # seconds by the table alone, whatever the machine has seen; 0 if they are unknown
    resident: float  # bytes that the process holds at most while the stage runs
    unknown: tuple[str, ...]  # addresses of stages, of this one or of its recipes, that nothing is known of
    unfit: tuple[ConfigError, ...] = ()  # options, of this one or of its recipes, that a run would refuse

    @property
    def advice(self) -> str:
        """Hint that makes the work smaller."""
        stage = self.step.stage
        return stage.advice or ("lower `resolution`" if hasattr(stage, "resolution") else "")


@dataclass(frozen=True)
class PlanEstimate:
    """All stages of a plan; sums leave out what is unknown."""

    stages: tuple[StageEstimate, ...]
    program: Cost
    """Of the program itself and its record."""
    compiling: Cost
    """Of the kernels that no earlier run has left on the disk."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Addresses of the stages that nothing is known of."""
        return tuple(dict.fromkeys(address for stage in self.stages for address in stage.unknown))

    @property
    def memory(self) -> float:
        """Bytes resident at most."""
        return self.compiling.memory + max(self.program.memory, *(stage.resident for stage in self.stages))

    @property
    def disk(self) -> float:
        """Bytes written."""
        return self.program.disk + sum(stage.cost.disk for stage in self.stages if stage.cost)

    @property
    def seconds(self) -> float:
        """On one core."""
        return self.start + sum(stage.cost.seconds for stage in self.stages if stage.cost)

    @property
    def start(self) -> float:
        """Seconds, of those, that the rows of a sweep share."""
        return self.program.seconds + self.compiling.seconds

    @property
    def handed_out(self) -> float | None:
        """Rated seconds of stages that hand work to the workers of a run; None if any is unknown."""
        handing = [stage for stage in self.stages if stage.step.stage.maps]
        if any(stage.cost is None or stage.unknown for stage in handing):
            return None
        return math.fsum(stage.rated for stage in handing)


def estimate_plan(
    plan: Plan, *, until: str | None = None, history: History = NONE_SEEN, of_sweep: bool = False
) -> PlanEstimate:
    """Estimate a plan without running it; of a row of a sweep, the stages of `after` run in the same process."""
    steps = plan.until(until)
    entries = len(steps) + sum(len(group) for group in plan.recipes.values())
    program = _program(entries)
    base = program.memory + (LEFT_BY_ROWS if of_sweep else 0.0)
    stages = estimate_steps(steps, plan.recipes, ONE, base, history)
    if of_sweep and until is None:
        after = estimate_steps(plan.after, {}, ONE, base, history, {SWEEP_ID: Size()})
        program = program._replace(
            seconds=program.seconds + sum(stage.cost.seconds for stage in after if stage.cost),
            memory=max([base, *(stage.resident for stage in after)]),
        )
    return PlanEstimate(stages, program, compiling_cost(plan))


def _program(entries: int) -> Cost:
    found = cost("sppm", {"stages": float(entries)})
    assert found is not None
    return found


def compiling_cost(plan: Plan) -> Cost:
    """Cost of compiling the kernels that a plan will call and that are not on the disk.

    Where child processes compile, before the first stage, memory is that of the process of the run. A kernel that was
    compiled for some of its kinds of arguments counts as compiled: a plan calls few of them for more than one kind, and
    each later run would be estimated 155 MB too high.
    """
    lacking = [kernel for kernel in missing_of(plan) if not is_kept(kernel.place, 1)]
    seconds = sum(kernel.seconds for kernel in lacking)
    apart = seconds >= MIN_SECONDS_AHEAD and os.environ.get(SWITCH, "").lower() != "off"
    return COMPILER._replace(seconds=seconds, memory=COMPILER.memory if lacking and not apart else 0.0)


def estimate_steps(
    steps: Sequence[Step],
    recipes: RecipeSteps,
    palette: Palette,
    base: float,
    history: History,
    available: Mapping[str, Size | None] = MappingProxyType({}),
) -> tuple[StageEstimate, ...]:
    """Estimate stages in order; `base` are bytes that are resident before the first, `available` what is there."""
    sizes = dict(available)
    kept: dict[str, float] = {}
    found: list[StageEstimate] = []
    for step, done in zip(steps, last_uses(steps), strict=True):
        inner: list[tuple[float, StageEstimate]] = []
        made = _size(step, sizes, recipes, palette, inner)
        size = None if isinstance(made, ConfigError) else made
        sizes[step.id] = size and (size.result or size)
        # a stage with `vary` replaces options of its recipe, whose own values then need not be allowed
        unfit = () if hasattr(step.stage, "vary") else tuple(error for _, stage in inner for error in stage.unfit)
        unfit = (*unfit, made) if isinstance(made, ConfigError) else unfit
        own = None if size is None else cost(step.stage.rated_as, size.units())
        unknown = tuple(address for _, stage in inner for address in stage.unknown)
        total = None
        rated = 0.0
        # results that later stages still need, this one's inputs among them
        resident = base + sum(kept.values())
        if own is None:
            unknown = (*unknown, step.address)
        else:
            costs = [(repeats, stage.cost) for repeats, stage in inner if stage.cost]
            rated = own.seconds + sum(repeats * stage.rated for repeats, stage in inner)
            memory = max(own.memory, own.kept, *(stage.resident for _, stage in inner), 0.0)
            disk = own.disk + sum(repeats * one.disk for repeats, one in costs)
            seconds, resident = by_history(history.get(step.stage.rated_as, ()), rated, resident + memory)
            total = Cost(seconds, memory, own.kept, disk)
        # stays in memory until the last stage that uses it has run
        kept[step.id] = total.kept if total else 0.0
        found.append(StageEstimate(step, size, total, rated, resident, unknown, unfit))
        for id_ in done:
            kept.pop(id_, None)
    return tuple(found)


def learn(store: Store, steps: Sequence[Step], recipes: RecipeSteps, record: Sequence[Mapping[str, Any]]) -> None:
    """Remember seconds and memory in the entries of a run record, for the next estimate."""
    entries = {entry["id"]: entry for entry in record if not entry.get("cached")}
    took = []
    for stage in estimate_steps(steps, recipes, ONE, _program(0).memory, {}) if entries else ():
        entry = entries.get(stage.step.id)
        if entry is not None and stage.cost is not None and not stage.unknown:
            # a process that has compiled kernels holds more than others will
            peak = 0.0 if has_compiled() else 1e6 * (entry.get("peak_memory_mb") or 0.0)
            took.append((stage.step.stage.rated_as, Seen(stage.rated, entry["seconds"], stage.resident, peak)))
    remember(store, took)


def _size(
    step: Step,
    sizes: Mapping[str, Size | None],
    recipes: RecipeSteps,
    palette: Palette,
    inner: list[tuple[float, StageEstimate]],
) -> Size | ConfigError | None:
    """The size that a stage estimates, or the error of options that do not fit what it is given; None if unknown.

    Other errors do not keep a stage from running: an `SppmError`, errors of the system, arithmetic on odd numbers and
    `LookupError` say that a size is unknown, and so does anything that follows from an input of unknown size. What is
    left is a mistake in the stage, and triggers a warning.
    """

    def recipe_size(name: str) -> RecipeSize:
        def of(palette: Palette = palette, repeats: float = 1.0) -> Size:
            stages = estimate_steps(recipes[name], recipes, palette, 0.0, {})
            inner.extend((repeats, stage) for stage in stages)
            kind = step.stage.returns
            made = [stage for stage in stages if kind is None or makes_kind(stage.step, kind)]
            if not made or (size := made[-1].size) is None:
                raise LookupError(f"the size of what {name!r} makes is unknown")
            return size.result or size

        return of

    inputs: dict[str, Size | None] = {port.name: None for port in step.signature.ports if port.optional}
    # None says that an optional port is open; a size that is unknown has no geometry
    unknown = {port: Size() if port in inputs else None for port in step.inputs}
    inputs |= {port: (sizes.get(source) or unknown[port]) if source else None for port, source in step.inputs.items()}
    made_by = {port: recipe_size(name) for port, name in step.recipes.items()}
    follows = any(source is not None and sizes.get(source) is None for source in step.inputs.values())
    given = {**step.signature.gathered(inputs), **made_by}
    try:
        usual = type(step.stage).estimate is Stage.estimate
        size = _usual_size(step, given.values()) if usual else step.stage.estimate(palette, **given)
        valid = isinstance(size, Size) and all(math.isfinite(n) and n >= 0 for n in size.units().values())
    except ConfigError as error:
        if follows:
            return None
        error.where, error.stage = error.where or step.where, error.stage or step.address
        return error
    except (SppmError, ArithmeticError, OSError, MemoryError):
        return None
    except Exception as error:
        if type(error) is not LookupError and not follows:
            warnings.warn(
                f"the estimate of {step.address!r} ({step.stage.name}) raised {described(error)}; this is "
                f"a mistake in {step.owner}, and what the stage takes is unknown",
                RuntimeWarning,
                stacklevel=2,
            )
        return None
    return size if valid else None


def _usual_size(step: Step, given: Iterable[Any]) -> Size | None:
    """The size of a stage that states none: of what it is given, or of what its recipe makes.

    On a grid if it has a `resolution`, with a picture if it has an `image_size`. Nothing follows of results of another
    kind, unless they are numbers.
    """
    stage, ports = step.stage, step.signature.ports
    kinds = (Report, *(kind for port in ports for kind in port.types))
    if not ports or not (step.signature.as_recipe or all(issubclass(made, kinds) for made in step.makes)):
        return None
    if step.signature.as_recipe:
        (made,) = (recipe() for recipe in given if callable(recipe))
        return Size(design=made.design, geometry=made.geometry)
    parts = [part for one in given for part in (one if isinstance(one, tuple) else (one,)) if isinstance(part, Size)]
    size = sum_of(parts)
    if hasattr(stage, "resolution") and not size.voxels:
        grid = size.grid(stage.resolution)
        size = replace(size, samples=grid.samples, sums=grid.sums, resident=grid.resident, voxels=grid.samples)
    pixels = float(math.prod(stage.image_size)) if hasattr(stage, "image_size") else size.pixels
    return replace(size, pixels=pixels)


def unfit_problems(
    estimates: Sequence[PlanEstimate],
    folder: Path,
    *,
    runs: int = 1,
    workers: int = 1,
    crew: int = 0,
) -> list[ResourceError]:
    """A `ResourceError` if memory or disk will not suffice, with what to change.

    `runs` runs write into `folder`, which need not exist, `workers` at the same time; the estimates are of rows that
    stand for all. `crew` worker processes of this machine, beside a single run, take as much as a stage that hands them
    work.
    """
    limit, words = allowed_memory()
    workers = min(workers, runs)
    # the user's own limit is meant as it stands
    slack = 1.0 if "--memory" in words else MAX_OVERESTIMATE
    for stage in (stage for estimate in estimates for stage in estimate.stages):
        # only then do workers hold what the stage holds
        helpers = crew if stage.step.stage.maps else 0
        needed = stage.resident * (workers + helpers)
        if stage.cost is not None and needed > slack * limit:
            message = (
                f"about {format_bytes(needed)} of memory would be needed; {words} is {format_bytes(limit)}"
                + (f" ({workers} runs at the same time)" if workers > 1 else "")
                + (f" ({helpers} workers and the program itself)" if helpers else "")
            )
            hint = stage.advice or "use a coarser resolution or a smaller part"
            return [ResourceError(message, hint=hint, where=stage.step.where, stage=stage.step.address)]
    # the mean of rows that stand for all, times their number
    free, needed = free_disk(folder), sum(estimate.disk for estimate in estimates) / len(estimates) * runs
    if free is not None and needed > MAX_OVERESTIMATE * free:
        largest = max(
            (stage for estimate in estimates for stage in estimate.stages),
            key=lambda stage: stage.cost.disk if stage.cost else 0.0,
        )
        message = (
            f"not enough disk: about {format_bytes(needed)} would be written; "
            f"free where {str(folder)!r} lies are {format_bytes(free)}"
        )
        hint = f"choose another place with -o; {largest.advice or 'use a coarser resolution'}"
        return [ResourceError(message, hint=hint, where=largest.step.where, stage=largest.step.address)]
    return []
