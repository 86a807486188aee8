"""Running a plan in memory: nothing is written, and every result is at hand."""

from __future__ import annotations

import datetime
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.run.events import Monitor, Observers
from sppm_pipeline.engine.run.outputs import Scratch
from sppm_pipeline.engine.run.record import record_of
from sppm_pipeline.engine.run.runner import StepRunner
from sppm_pipeline.errors import ConfigError, did_you_mean

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store


class MemoryRun:
    """A run that has written nothing: its `record`, without digests and audit, and what its stages made.

    Stages that only write files are marked ``skipped`` in the record.
    """

    def __init__(self, record: dict[str, Any], runner: StepRunner) -> None:
        self.record = record
        self.runner = runner

    def result(self, id_: str) -> Any:
        """The result of a stage, also if it came from the cache; None for a stage that makes nothing."""
        ids = [entry["id"] for entry in self.record["stages"]]
        if id_ not in ids:
            raise ConfigError(f"the run has no stage {id_!r}", hint=did_you_mean(str(id_), ids))
        try:
            return self.runner.result(id_)
        finally:
            self.runner.close()


def run_in_memory(
    plan: Plan,
    *,
    threads: int,
    until: str | None = None,
    monitor: Monitor | None = None,
    store: Store | None = None,
    about: str = "",
    available: Mapping[str, Any] = MappingProxyType({}),
) -> MemoryRun:
    """Run the pipeline without a run directory and keep what every stage makes.

    Stages that make nothing but files are left out; hand the result to `run_plan` as `earlier` to run them. Files that
    other stages write on the way are thrown away. `available` are results, by id, that are there before the first step.
    """
    steps = plan.until(until)
    monitor = monitor or Monitor()
    started, began = datetime.datetime.now(datetime.UTC), time.perf_counter()
    warnings = list(plan.warnings)
    for message in warnings:
        monitor.warning(None, message)

    def warn(message: str) -> None:
        warnings.append(message)
        monitor.warning(None, message)

    with tempfile.TemporaryDirectory(prefix="sppm-") as scratch:
        runner = StepRunner(
            steps=steps,
            recipes=plan.recipes,
            seed=plan.seed,
            threads=threads,
            folder=Scratch(Path(scratch)),
            monitor=monitor,
            observers=Observers([monitor], plan.plugins, warn),
            store=store,
            about=about,
            available=available,
            keep={step.id for step in steps},
        )
        runner.run()
    record = record_of(
        plan,
        runner.entries,
        status="done",
        error=None,
        started=started,
        seconds=time.perf_counter() - began,
        threads=threads,
        until=until,
        warnings=warnings,
    )
    return MemoryRun(record, runner)
