"""Estimating what a plan will take, stage by stage along the wiring, and refusing what can't fit."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.rates import WORTH, Cost, Speed, cost, learn_speed
from sppm_pipeline.engine.plan.wiring import Step, last_uses, makes_kind
from sppm_pipeline.engine.process.budget import MEMORY, allowed_memory, format_bytes, free_disk
from sppm_pipeline.errors import ResourceError, SppmError
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.nouns.size import ONE, RecipeSize, Size

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store

TRUST = 1.3
"""An estimate may be this much too high before a run is refused that the machine might just manage."""

RecipeSteps = Mapping[str, Sequence[Step]]


@dataclass(frozen=True)
class StageEstimate:
    """One stage of a plan.

    Attributes
    ----------
    step : Step
    size : Size or None
        None if the stage does not tell it.
    cost : Cost or None
        With those of its recipes; None if the size or the rates are unknown.
    resident : float
        Bytes that the process holds at most while the stage runs.
    unknown : tuple of str
        Addresses of stages, of this one or of its recipes, that nothing is known of.
    """

    step: Step
    size: Size | None
    cost: Cost | None
    resident: float
    unknown: tuple[str, ...]

    @property
    def advice(self) -> str:
        """What makes the work smaller."""
        stage = self.step.stage
        return stage.advice or ("lower `resolution`" if hasattr(stage, "resolution") else "")


@dataclass(frozen=True)
class PlanEstimate:
    """All stages of a plan; sums leave out what is unknown."""

    stages: tuple[StageEstimate, ...]
    program: Cost
    """Of the program itself and its record."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """Addresses of the stages that nothing is known of."""
        return tuple(dict.fromkeys(address for stage in self.stages for address in stage.unknown))

    @property
    def memory(self) -> float:
        """Bytes resident at most."""
        return max((stage.resident for stage in self.stages), default=self.program.memory)

    @property
    def disk(self) -> float:
        """Bytes written."""
        return self.program.disk + sum(stage.cost.disk for stage in self.stages if stage.cost)

    @property
    def seconds(self) -> float:
        """On one core."""
        return self.program.seconds + sum(stage.cost.seconds for stage in self.stages if stage.cost)

    @property
    def handed_out(self) -> float | None:
        """Seconds, of those, of stages that hand work to the workers of a run; None if any is unknown."""
        handing = [stage for stage in self.stages if stage.step.stage.maps]
        if any(stage.cost is None or stage.unknown for stage in handing):
            return None
        return math.fsum(stage.cost.seconds for stage in handing if stage.cost)


def estimate_plan(plan: Plan, *, until: str | None = None, speed: Speed | None = None) -> PlanEstimate:
    """Estimate a plan without running it.

    Parameters
    ----------
    plan : Plan
    until : str, optional
        Id of the last stage that will run.
    speed : Speed, optional
        Of this machine, if it is known.
    """
    steps = plan.until(until)
    entries = len(steps) + sum(len(group) for group in plan.recipes.values())
    program = cost("sppm", {"stages": float(entries)})
    assert program is not None
    return PlanEstimate(estimate_steps(steps, plan.recipes, ONE, program.memory, speed or {}), program)


def estimate_steps(
    steps: Sequence[Step],
    recipes: RecipeSteps,
    palette: Palette,
    base: float,
    speed: Speed,
) -> tuple[StageEstimate, ...]:
    """Estimate stages in order; `base` are bytes that are resident before the first."""
    sizes: dict[str, Size | None] = {}
    kept: dict[str, float] = {}
    found: list[StageEstimate] = []
    for step, done in zip(steps, last_uses(steps), strict=True):
        inner: list[tuple[float, StageEstimate]] = []
        size = sizes[step.id] = _size(step, sizes, recipes, palette, speed, inner)
        key = step.stage.rated_as
        own = None if size is None else cost(key, size.units(), factor=speed.get(key, 1.0))
        unknown = tuple(address for _, stage in inner for address in stage.unknown)
        total = None
        if own is None:
            unknown = (*unknown, step.address)
        else:
            costs = [(repeats, stage.cost) for repeats, stage in inner if stage.cost]
            total = Cost(
                seconds=own.seconds + sum(repeats * one.seconds for repeats, one in costs),
                memory=max(own.memory, own.kept, *(stage.resident for _, stage in inner), 0.0),
                kept=own.kept,
                disk=own.disk + sum(repeats * one.disk for repeats, one in costs),
            )
        resident = base + sum(kept.values()) + (total.memory if total else 0.0)
        kept[step.id] = total.kept if total else 0.0
        found.append(StageEstimate(step, size, total, resident, unknown))
        for id_ in done:
            kept.pop(id_, None)
    return tuple(found)


def learn(store: Store, steps: Sequence[Step], recipes: RecipeSteps, record: Sequence[Mapping[str, Any]]) -> None:
    """Compare the seconds in the entries of a run record with the table of rates, for the next estimate."""
    took = {entry["id"]: entry["seconds"] for entry in record if not entry.get("cached") and entry["seconds"] > WORTH}
    if took:
        stages = estimate_steps(steps, recipes, ONE, 0.0, {})
        known = [stage for stage in stages if stage.step.id in took and stage.cost and not stage.unknown]
        learn_speed(store, {s.step.stage.rated_as: (took[s.step.id], s.cost.seconds) for s in known if s.cost})


def _size(
    step: Step,
    sizes: Mapping[str, Size | None],
    recipes: RecipeSteps,
    palette: Palette,
    speed: Speed,
    inner: list[tuple[float, StageEstimate]],
) -> Size | None:
    """The size that a stage tells; whatever goes wrong is no reason not to run, but mistakes are warned of.

    Errors of the house and of the system, arithmetic on odd numbers and `LookupError` say that a size is unknown, and
    so does anything that follows from an input of unknown size.
    """

    def recipe_size(name: str) -> RecipeSize:
        def of(palette: Palette = palette, repeats: float = 1.0) -> Size:
            stages = estimate_steps(recipes[name], recipes, palette, 0.0, speed)
            inner.extend((repeats, stage) for stage in stages)
            kind = step.stage.returns
            made = [stage for stage in stages if kind is None or makes_kind(stage.step, kind)]
            if not made or (size := made[-1].size) is None:
                raise LookupError(f"the size of what {name!r} makes is unknown")
            return size

        return of

    inputs: dict[str, Size | None] = {port.name: None for port in step.signature.ports if port.optional}
    # None says that an optional port is open; a size that is unknown has no geometry
    unknown = {port: Size() if port in inputs else None for port in step.inputs}
    inputs |= {port: (sizes.get(source) or unknown[port]) if source else None for port, source in step.inputs.items()}
    made_by = {port: recipe_size(name) for port, name in step.recipes.items()}
    try:
        size = step.stage.estimate(palette, **{**step.signature.gathered(inputs), **made_by})
        valid = isinstance(size, Size) and all(math.isfinite(n) and n >= 0 for n in size.units().values())
    except (SppmError, ArithmeticError, OSError, MemoryError):
        return None
    except Exception as error:
        follows = any(source is not None and sizes.get(source) is None for source in step.inputs.values())
        if type(error) is not LookupError and not follows:
            warnings.warn(
                f"the estimate of {step.address!r} ({step.stage.name}) raised {type(error).__name__}: {error}; this is "
                f"a mistake in {step.owner}, and what the stage takes is unknown",
                RuntimeWarning,
                stacklevel=2,
            )
        return None
    return size if valid else None


def refuse_what_cannot_fit(
    estimate: PlanEstimate,
    folder: Path,
    *,
    runs: int = 1,
    workers: int = 1,
    crew: int = 0,
    memory: tuple[int | None, str] | None = None,
) -> None:
    """Raise `ResourceError` if memory or disk will not do, with what to change.

    Parameters
    ----------
    estimate : PlanEstimate
        Of one run.
    folder : Path
        The run directory, which need not exist.
    runs : int
        Runs that write into it.
    workers : int
        Runs at the same time.
    crew : int
        Worker processes of this machine beside each run, which take as much as a stage that hands them work.
    memory : (bytes or None, words), optional
        What may be taken, and what limits it; that of this machine if omitted.
    """
    limit, words = memory or allowed_memory()
    # the user's own limit is meant as it stands
    slack = 1.0 if MEMORY in words or "--memory" in words else TRUST
    for stage in estimate.stages:
        helpers = crew if stage.step.stage.maps else 0
        needed = stage.resident * (workers + helpers)
        if limit is not None and stage.cost is not None and needed > slack * limit:
            raise ResourceError(
                f"about {format_bytes(needed)} of memory would be needed; {words} is {format_bytes(limit)}"
                + (f" ({workers} runs at the same time)" if workers > 1 else "")
                + (f" ({helpers} workers and the program itself)" if helpers else ""),
                hint=stage.advice or "use a coarser resolution or a smaller part",
                where=stage.step.where,
                stage=stage.step.address,
            )
    free, needed = free_disk(folder), estimate.disk * runs
    if free is not None and needed > TRUST * free:
        largest = max(estimate.stages, key=lambda stage: stage.cost.disk if stage.cost else 0.0)
        raise ResourceError(
            f"not enough disk: about {format_bytes(needed)} would be written; "
            f"free where {str(folder)!r} lies are {format_bytes(free)}",
            hint=f"choose another place with -o; {largest.advice or 'use a coarser resolution'}",
            where=largest.step.where,
            stage=largest.step.address,
        )
