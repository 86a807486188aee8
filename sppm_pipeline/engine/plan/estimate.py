"""Foretelling what a plan will take, stage by stage along the wiring, and refusing what can't fit."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from sppm_pipeline.data.estimate import Estimate, Facts, Given
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.wiring import Step, last_uses
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.process.resources import MEMORY, allowed_memory, free_disk, words_for_bytes

BASE = 150e6
"""Bytes of the program with its libraries and compiled kernels."""

RECORD, RECORD_STAGE = 2e3, 450
"""Bytes of ``run.json``, and of each stage in it."""

START = 0.6
"""Seconds for starting the program."""

TRUST = 1.3
"""A forecast may be this much too high before a run is refused that the machine might just manage."""


@dataclass(frozen=True)
class Foretold:
    """One stage of a plan; `estimate` is None if the stage can't say, or knows too little of its inputs."""

    step: Step
    estimate: Estimate | None
    memory: float
    """Bytes resident while it runs: the program, all results that are kept, and its own."""


@dataclass(frozen=True)
class Forecast:
    """All stages of a plan."""

    stages: tuple[Foretold, ...]
    unknown: tuple[str, ...] = field(default=())
    """Ids of the stages that nothing is known of."""
    record: float = 0.0
    """Bytes of the run record."""

    @property
    def memory(self) -> float:
        """Bytes resident at most."""
        return max((stage.memory for stage in self.stages), default=BASE)

    @property
    def disk(self) -> float:
        """Bytes written."""
        return self.record + sum(stage.estimate.disk for stage in self.stages if stage.estimate)

    @property
    def seconds(self) -> float:
        """On one core."""
        return START + sum(stage.estimate.seconds for stage in self.stages if stage.estimate)

    @property
    def voxels(self) -> float:
        """Samples of fields."""
        return sum(stage.estimate.voxels for stage in self.stages if stage.estimate)

    @property
    def layers(self) -> int:
        """Layers written or computed."""
        return sum(stage.estimate.layers for stage in self.stages if stage.estimate)


def estimate_plan(plan: Plan, *, until: str | None = None) -> Forecast:
    """Foretell a plan without running it.

    Parameters
    ----------
    plan : Plan
    until : str, optional
        Id of the last stage that will run.

    Raises
    ------
    SppmError
        If a stage finds, while foretelling, that it will not be able to work.
    """
    steps = list(plan.steps)
    if until is not None:
        steps = steps[: [step.id for step in steps].index(until) + 1]
    entries = len(steps) + sum(len(group) for group in plan.recipes.values())
    return replace(_walk(steps, plan.recipes, Palette()), record=RECORD + RECORD_STAGE * entries)


def _walk(steps: Sequence[Step], recipes: Mapping[str, Sequence[Step]], palette: Palette) -> Forecast:
    facts: dict[str, Facts] = {}
    kept: dict[str, float] = {}
    stages: list[Foretold] = []
    unknown: list[str] = []
    for step, done in zip(steps, last_uses(steps), strict=True):
        given = Given(
            palette,
            {port: facts.get(source, {}) if source else None for port, source in step.inputs.items()},
            {port: _recipe(name, recipes) for port, name in step.recipes.items()},
        )
        found = _of_stage(step, given)
        if found is None:
            unknown.append(step.id)
        else:
            facts[step.id] = found.makes
            kept[step.id] = found.keeps
        held = sum(kept.values())
        stages.append(Foretold(step, found, BASE + held + (found.memory if found else 0.0)))
        for id_ in done:
            kept.pop(id_, None)
    return Forecast(tuple(stages), tuple(unknown))


def _of_stage(step: Step, given: Given) -> Estimate | None:
    """The estimate of one stage; whatever goes wrong in it is no reason not to run."""
    try:
        found = step.stage.estimate(given)
    except Exception:
        return None
    if not isinstance(found, Estimate):
        return None
    numbers = (found.keeps, found.memory, found.disk, found.seconds, found.voxels, found.layers)
    return found if all(isinstance(n, (int, float)) and math.isfinite(n) and n >= 0 for n in numbers) else None


def _recipe(name: str, recipes: Mapping[str, Sequence[Step]]) -> Callable[[Palette], Estimate]:
    def run(palette: Palette) -> Estimate:
        forecast = _walk(recipes[name], recipes, palette)
        last = forecast.stages[-1].estimate
        return Estimate(
            makes=last.makes if last else {},
            keeps=last.keeps if last else 0.0,
            memory=forecast.memory - BASE,
            disk=forecast.disk,
            seconds=forecast.seconds - START,
            voxels=forecast.voxels,
            layers=forecast.layers,
        )

    return run


def refuse_what_cannot_fit(
    forecast: Forecast, folder: Path, *, runs: int = 1, workers: int = 1, memory: tuple[int | None, str] | None = None
) -> None:
    """Raise `ResourceError` if memory or disk will not do, with what to change.

    Parameters
    ----------
    forecast : Forecast
        Of one run.
    folder : Path
        The run directory, which need not exist.
    runs : int
        Runs that write into it.
    workers : int
        Runs at the same time.
    memory : (bytes or None, words), optional
        What may be taken, and what limits it; that of this machine if omitted.
    """
    limit, words = memory or allowed_memory()
    # the user's own limit is meant as it stands
    slack = 1.0 if MEMORY in words or "--memory" in words else TRUST
    for stage in forecast.stages:
        needed = stage.memory * workers
        if limit is not None and stage.estimate is not None and needed > slack * limit:
            raise ResourceError(
                f"about {words_for_bytes(needed)} of memory would be needed; {words} is {words_for_bytes(limit)}"
                + (f" ({workers} runs at the same time)" if workers > 1 else ""),
                hint=stage.estimate.advice or "use a coarser resolution or a smaller part",
                where=stage.step.where,
                stage=stage.step.address,
            )
    free, needed = free_disk(folder), forecast.disk * runs
    if free is not None and needed > TRUST * free:
        largest = max(forecast.stages, key=lambda stage: stage.estimate.disk if stage.estimate else 0.0)
        advice = largest.estimate.advice if largest.estimate else ""
        raise ResourceError(
            f"about {words_for_bytes(needed)} would be written; free where {str(folder)!r} lies are "
            f"{words_for_bytes(free)}",
            hint=f"choose another place with -o; {advice or 'use a coarser resolution'}",
            where=largest.step.where,
            stage=largest.step.address,
        )
