"""Running a plan into a run directory."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.engine.config.problems import did_you_mean
from sppm_pipeline.engine.plan.planning import Plan, step_options
from sppm_pipeline.engine.plan.rates import learn_speed
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.run.context import RunContext, StageLog
from sppm_pipeline.engine.run.monitor import Monitor
from sppm_pipeline.engine.run.outputs import RunFolder, Scratch
from sppm_pipeline.engine.run.record import peak_memory_mb
from sppm_pipeline.engine.run.recorder import Recorder
from sppm_pipeline.engine.run.running import RecipeSteps, last_uses, run_step, summary_of
from sppm_pipeline.engine.run.verification import finished_run
from sppm_pipeline.errors import ConfigError, SppmError
from sppm_pipeline.process.interruption import check

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.keeper import CacheSession
    from sppm_pipeline.engine.cache.store import Store


def available_threads() -> int:
    """Processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def check_until(plan: Plan, until: str | None) -> None:
    """Raise `ConfigError` if the pipeline has no stage `until`."""
    ids = [step.id for step in plan.steps]
    if until is not None and until not in ids:
        raise ConfigError(f"--until: the pipeline has no stage {until!r}", hint=did_you_mean(until, ids))


def run_plan(
    plan: Plan,
    path: Path,
    *,
    threads: int,
    until: str | None = None,
    monitor: Monitor | None = None,
    store: Store | None = None,
    about: str = "",
    key: str | None = None,
) -> dict[str, Any]:
    """Run the pipeline and write ``run.json``, also when a stage fails.

    Parameters
    ----------
    plan : Plan
    path : Path
        The run directory.
    threads : int
        Threads that each stage may use.
    until : str, optional
        Id of the last stage to run.
    monitor : Monitor, optional
        Is told what happens.
    store : Store, optional
        The cache; without one every stage runs, and nothing is kept.
    about : str
        Name under which the cache remembers this run for `sppm explain`.
    key : str, optional
        Digest of all that the run depends on; with a store, a finished run of the same key in `path` that is sound to
        the byte is taken as it is.

    Returns
    -------
    dict
        The record.

    Raises
    ------
    SppmError
        What stopped the run; its attribute ``record`` holds the record.
    """
    check_until(plan, until)
    monitor = monitor or Monitor()
    if store is not None and key is not None and (finished := finished_run(path, key)) is not None:
        return finished
    with Recorder(plan, path, threads=threads, until=until, monitor=monitor) as recorder:
        if key is not None:
            recorder.extra["key"] = key
        run_steps(
            plan.steps,
            plan.recipes,
            recorder.stages,
            seed=plan.seed,
            threads=threads,
            until=until,
            folder=recorder.folder,
            monitor=monitor,
            store=store,
            about=about,
            checkpoint=recorder.checkpoint,
        )
    return recorder.record


def run_steps(
    steps: Sequence[Step],
    recipes: RecipeSteps,
    stages: list[dict[str, Any]],
    *,
    seed: int,
    threads: int,
    until: str | None,
    folder: RunFolder | None,
    monitor: Monitor,
    given: Mapping[str, Any] | None = None,
    store: Store | None = None,
    about: str = "",
    checkpoint: Callable[[], None] = lambda: None,
) -> dict[str, Any]:
    """Run stages in order, append what is known of each to `stages`, free results nobody needs any more.

    A stage whose result is in the cache does not run, and the result is only loaded if a later stage needs it.

    Returns the results that are left: that of the last stage, unless it came from the cache.
    """
    if until is not None:
        steps = steps[: [step.id for step in steps].index(until) + 1]
    keeper: CacheSession | None = None
    if store is not None:
        from sppm_pipeline.engine.cache.keeper import CacheSession

        keeper = CacheSession(store, monitor, seed=seed, recipes=recipes, about=about)
    run = _Run(steps, recipes, seed, threads, folder, monitor, keeper, dict(given or {}), checkpoint)
    try:
        last = last_uses(steps)
        for number, step in enumerate(steps, 1):
            check()
            monitor.stage_started(step.id, number, len(steps))
            entry = run.step(step)
            stages.append(entry)
            monitor.stage_finished(step.id, entry["seconds"], entry["summary"])
            if number < len(steps):
                run.forget({id_ for done in last[:number] for id_ in done})
        if store is not None:
            learn_speed(store, steps, recipes, stages)
    finally:
        if keeper is not None:
            keeper.close()
    return run.results


class _Run:
    """The steps of one run and what they made so far."""

    def __init__(
        self,
        steps: Sequence[Step],
        recipes: RecipeSteps,
        seed: int,
        threads: int,
        folder: RunFolder | None,
        monitor: Monitor,
        keeper: CacheSession | None,
        given: dict[str, Any],
        checkpoint: Callable[[], None],
    ) -> None:
        self.results = given
        self._steps = {step.id: step for step in steps}
        self._recipes = recipes
        self._seed = seed
        self._threads = threads
        self._folder = folder
        self._monitor = monitor
        self._keeper = keeper
        self._checkpoint = checkpoint
        if keeper is not None:
            for id_, artifact in given.items():
                keeper.given(id_, artifact.digest())

    def step(self, step: Step) -> dict[str, Any]:
        """Take a step from the cache or run it; its entry in the record."""
        started = time.perf_counter()
        facts = self._kept(step) if self._keeper is not None else None
        cached = facts is not None
        if facts is None:
            facts = self._fresh(step)
        entry: dict[str, Any] = {
            "id": step.id,
            "stage": step.stage.name,
            "made": facts["made"],
            "seconds": round(time.perf_counter() - started, 6),
            "peak_memory_mb": peak_memory_mb(),
            "cached": cached,
            "summary": facts["summary"],
            "options": step_options(step),
            "inputs": dict(step.inputs),
            "recipes": dict(step.recipes),
            "warnings": [message if at == step.address else f"{at}: {message}" for at, message in facts["warnings"]],
            "outputs": facts["outputs"],
            "inner": facts["inner"],
        }
        empty: tuple[Any, ...] = ({}, [], False)
        return {name: value for name, value in entry.items() if value not in empty or name == "summary"}

    def forget(self, ids: set[str]) -> None:
        """Free results that nobody needs any more."""
        for id_ in ids:
            self.results.pop(id_, None)

    def _kept(self, step: Step) -> dict[str, Any] | None:
        """What the cache says of a step whose outputs are there or could be written again."""
        assert self._keeper is not None
        entry = self._keeper.look_up(step, (step.id,))
        if entry is None:
            return None
        facts = dict(entry.facts)
        outputs = facts["outputs"]
        if outputs:
            if self._folder is None:
                return None
            there = self._folder.holds(step.address, outputs)
            if not there and not self._keeper.restore(step, self._folder, outputs, self._checkpoint):
                return None
        for at, message in facts["warnings"]:
            self._monitor.warning(at, message)
        return facts

    def _fresh(self, step: Step) -> dict[str, Any]:
        """Run a step; what the record says of it."""
        log = StageLog(self._monitor, step.address)
        inputs = self._inputs(step)
        started = time.perf_counter()
        made = self._made(step, inputs, log, self._folder)
        facts = self._facts(step, made, log)
        if self._folder is not None and self._folder.pending():
            try:
                self._checkpoint()
                facts["outputs"] = self._folder.commit()
            except SppmError as error:
                error.where, error.stage = step.where, step.address
                raise
        if self._keeper is not None:
            seconds = time.perf_counter() - started
            outputs = [(o["path"], self._folder.path / o["path"]) for o in facts["outputs"]] if self._folder else []
            self._keeper.keep(step, facts, made, inputs, outputs=outputs, seconds=seconds, drew=log.drew)
        self.results[step.id] = made
        return facts

    def _facts(self, step: Step, made: Any, log: StageLog) -> dict[str, Any]:
        return {
            "made": None if made is None else type(made).__name__,
            "summary": summary_of(made, log.values.get(step.address, {}), step),
            "warnings": [list(warning) for warning in log.warnings],
            "outputs": [],
            "inner": list(log.inner.values()),
        }

    def _made(self, step: Step, inputs: Mapping[str, Any], log: StageLog, folder: RunFolder | Scratch | None) -> Any:
        context = RunContext(
            seed=self._seed,
            path=(step.id,),
            address=step.address,
            threads=self._threads,
            palette=Palette(),
            log=log,
            folder=folder,
        )
        return run_step(step, step.stage, inputs, context, self._recipes)

    def _inputs(self, step: Step) -> dict[str, Any]:
        return {port: self._result(source) if source else None for port, source in step.inputs.items()}

    def _result(self, id_: str) -> Any:
        """What a step made: still there, loaded, or made again because only the facts of it were kept."""
        if id_ in self.results:
            return self.results[id_]
        assert self._keeper is not None
        step = self._steps[id_]
        same_as = self._keeper.same_as(id_)
        made = self._result(source) if same_as and (source := step.inputs[same_as]) else self._keeper.load(id_)
        if made is None:
            inputs = self._inputs(step)
            scratch = self._folder.scratch() if self._folder is not None else None
            log = StageLog(Monitor(), step.address)
            started = time.perf_counter()
            try:
                made = self._made(step, inputs, log, scratch)
            finally:
                if scratch is not None:
                    scratch.discard()
            self._keeper.keep_again(step, made, inputs, time.perf_counter() - started)
        self.results[id_] = made
        return made
