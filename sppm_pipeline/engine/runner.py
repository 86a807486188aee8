"""Running a plan into a run directory."""

from __future__ import annotations

import datetime
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.engine.context import RunContext, StageLog
from sppm_pipeline.engine.jsonable import json_text
from sppm_pipeline.engine.monitor import Monitor
from sppm_pipeline.engine.outputs import RECORD, RunFolder, write_whole
from sppm_pipeline.engine.plan import Plan, step_options
from sppm_pipeline.engine.problems import did_you_mean
from sppm_pipeline.engine.record import peak_memory_mb, record_of
from sppm_pipeline.engine.running import RecipeSteps, last_uses, run_step, summary_of
from sppm_pipeline.engine.wiring import Step
from sppm_pipeline.errors import ConfigError, SppmError

__all__ = ["Recorder", "available_threads", "check_until", "run_plan", "run_steps"]


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


class Recorder:
    """Keeps ``run.json`` of a run directory true: written when the run begins and however it ends.

    Attributes
    ----------
    folder : RunFolder
    stages : list of dict
        Filled by `run_steps`.
    extra : dict
        Further entries of the record.
    status : str
        What the record says after a good end.
    record : dict
        As written last.
    """

    def __init__(self, plan: Plan, path: Path, *, threads: int, until: str | None, monitor: Monitor) -> None:
        self._plan = plan
        self._threads = threads
        self._until = until
        self._monitor = monitor
        self.folder = RunFolder(path)
        self.stages: list[dict[str, Any]] = []
        self.extra: dict[str, Any] = {}
        self.status = "done"
        self.record: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        self.folder.prepare()
        self._began, self._started = datetime.datetime.now(datetime.UTC), time.perf_counter()
        self._write("running", None)  # from here on the directory is known to be a run's
        for message in self._plan.warnings:
            self._monitor.warning(None, message)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self.folder.discard()
        if error is None:
            self._write(self.status, None)
        elif isinstance(error, SppmError):
            self._write("failed", error)
            error.record = self.record  # type: ignore[attr-defined]
        else:
            self._write("interrupted" if isinstance(error, KeyboardInterrupt) else "failed", None)

    def _write(self, status: str, error: SppmError | None) -> None:
        self.record = record_of(
            self._plan,
            self.stages,
            status=status,
            error=error,
            started=self._began,
            seconds=time.perf_counter() - self._started,
            threads=self._threads,
            until=self._until,
            extra=self.extra,
        )
        write_whole(self.folder.path / RECORD, json_text(self.record), durable=status != "running")


def run_plan(
    plan: Plan, path: Path, *, threads: int, until: str | None = None, monitor: Monitor | None = None
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
    with Recorder(plan, path, threads=threads, until=until, monitor=monitor) as recorder:
        run_steps(
            plan.steps,
            plan.recipes,
            recorder.stages,
            seed=plan.seed,
            threads=threads,
            until=until,
            folder=recorder.folder,
            monitor=monitor,
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
) -> dict[str, Any]:
    """Run stages in order, append what is known of each to `stages`, free results nobody needs any more.

    Returns the results that are left: that of the last stage.
    """
    results: dict[str, Any] = dict(given or {})
    if until is not None:
        steps = steps[: [step.id for step in steps].index(until) + 1]
    for number, (step, done) in enumerate(zip(steps, last_uses(steps), strict=True), 1):
        monitor.stage_started(step.id, number, len(steps))
        log = StageLog(monitor, step.address)
        context = RunContext(
            seed=seed,
            path=(step.id,),
            address=step.address,
            threads=threads,
            palette=Palette(),
            log=log,
            folder=folder,
        )
        inputs = {port: results[source] if source else None for port, source in step.inputs.items()}
        started = time.perf_counter()
        made = run_step(step, step.stage, inputs, context, recipes)
        del inputs
        try:
            outputs = folder.commit() if folder is not None else []
        except SppmError as error:
            error.where, error.stage = step.where, step.address
            raise
        seconds = time.perf_counter() - started
        summary = summary_of(made, log.values.get(step.address, {}), step)
        entry: dict[str, Any] = {
            "id": step.id,
            "stage": step.stage.name,
            "made": None if made is None else type(made).__name__,
            "seconds": round(seconds, 6),
            "peak_memory_mb": peak_memory_mb(),
            "summary": summary,
            "options": step_options(step),
            "inputs": dict(step.inputs),
            "recipes": dict(step.recipes),
            "warnings": [message if at == step.address else f"{at}: {message}" for at, message in log.warnings],
            "outputs": outputs,
            "inner": list(log.inner.values()),
        }
        stages.append({name: value for name, value in entry.items() if value not in ({}, []) or name == "summary"})
        monitor.stage_finished(step.id, seconds, summary)
        results[step.id] = made
        del made
        for id_ in done if number < len(steps) else ():
            results.pop(id_, None)
    return results
