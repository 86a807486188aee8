"""Runs of pipelines: results in memory by stage id, numbers, and the same files as on the command line."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.api.monitor import SweepProgress, SweepWarnings, WarningMonitor
from sppm_pipeline.engine.cache.housekeeping import open_store
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.config.document import plain
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.session import Session
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.memory import MemoryRun, run_in_memory
from sppm_pipeline.engine.run.record import error_entry
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.sweep import run_sweep
from sppm_pipeline.engine.run.sweep_table import columns_of, numbers_of, units_of
from sppm_pipeline.errors import ConfigError, SppmError, did_you_mean
from sppm_pipeline.nouns.artifact import escaped, shown
from sppm_pipeline.nouns.table import Table
from sppm_pipeline.nouns.viewers import viewer_of


class Numbers(dict[str, float]):
    """The numbers of a run by ``<stage id>.<name>``; of an unknown one it is said what is known."""

    def __missing__(self, name: str) -> float:
        hint = did_you_mean(name, self) or "no stage of the run reports numbers"
        raise ConfigError(f"the run has no number {name!r}", hint=hint)


class Run:
    """Results of a pipeline: artifacts by stage id, numbers, and the record.

    Attributes
    ----------
    record : dict
        As ``run.json`` holds it.
    table : Table or None
        Of a sweep: a row for each run.
    """

    def __init__(self, session: Session, plan: Plan, *, until: str | None, threads: int, cache: Path | None) -> None:
        self.record: dict[str, Any] = {}
        self.table: Table | None = None
        self._session = session
        self._plan = plan
        self._until = until
        self._threads = threads
        self._cache = cache
        self._memory: MemoryRun | None = None

    def __getitem__(self, stage: str) -> Any:
        """The result of a stage; None for one that makes nothing.

        Raises
        ------
        ConfigError
            If there is no stage of this id, or the run is a sweep.
        """
        if self.table is not None:
            raise ConfigError("a sweep has no single result", hint="run.table has the numbers of all runs")
        return self._run().result(stage)

    def __iter__(self) -> Iterator[str]:
        """The ids of the stages."""
        return (step.id for step in self._plan.until(self._until))

    @property
    def numbers(self) -> dict[str, float]:
        """Numbers of all stages as ``<stage id>.<name>``, the columns of a sweep's table.

        Raises
        ------
        ConfigError
            If the run is a sweep.
        """
        if self.table is not None:
            raise ConfigError(
                f"a sweep has the numbers of {self.table.rows} runs",
                hint="ask run.table: .to_pandas(), .to_xarray(), or .numbers(name) of " + self._columns(),
            )
        return Numbers(numbers_of(self.record.get("stages", ())))

    def _columns(self) -> str:
        names = [name for name in self.table.columns if "." in name] if self.table is not None else []
        return ", ".join(names[:8]) + (", ..." if len(names) > 8 else "") if names else "its columns"

    def save(self, path: str | Path, *, jobs: int = 1) -> dict[str, Any]:
        """Write the run directory, as ``sppm run`` does; stages that only write run now.

        Parameters
        ----------
        path : str or Path
        jobs : int
            Rows of a sweep that run at the same time.

        Returns
        -------
        dict
            The record.
        """
        monitor = WarningMonitor()
        if self.table is not None:
            self.record = run_sweep(
                self._session,
                self._plan,
                Path(path),
                WorkerOptions(workers=jobs, executor="threads", threads=self._threads, cache=self._cache),
                until=self._until,
                monitor=monitor,
            )
        else:
            self.record = run_plan(
                self._plan,
                Path(path),
                threads=self._threads,
                until=self._until,
                monitor=monitor,
                store=self._store(),
                about=self._about(),
                earlier=self._run().runner,
            )
        return self.record

    def _run(self) -> MemoryRun:
        if self._memory is None:
            self._memory = run_in_memory(
                self._plan,
                threads=self._threads,
                until=self._until,
                monitor=WarningMonitor(),
                store=self._store(),
                about=self._about(),
            )
            self.record = self.record or self._memory.record
        return self._memory

    def _run_rows(self, rows: Sequence[Mapping[str, Any]], jobs: int) -> None:
        """Run the rows of a sweep in memory and keep their numbers."""

        def one(number: int) -> dict[str, Any]:
            row = rows[number]
            result: dict[str, Any] = {
                "run": f"{number:04}",
                "params": {name: plain(entry.node) for name, entry in row.items()},
                "status": "done",
                "error": None,
                "columns": {},
            }
            try:
                plan = self._session.plan(row)
                memory = run_in_memory(
                    plan,
                    threads=max(1, self._threads // jobs),
                    until=self._until,
                    monitor=monitor,
                    store=self._store(),
                    about=self._about(),
                )
                result["columns"] = numbers_of(memory.record["stages"])
                units.update(units_of(plan.steps, memory.record["stages"]))
            except SppmError as error:
                result |= {"status": "failed", "error": error_entry(error)}
            with lock:
                progress.row_finished(result["status"] == "done")
            return result

        monitor, progress, lock, units = SweepWarnings(), SweepProgress(len(rows)), threading.Lock(), dict[str, str]()
        try:
            with ThreadPoolExecutor(max(1, jobs)) as pool:
                runs = list(pool.map(one, range(len(rows))))
        finally:
            progress.close()
            monitor.close()
        self.table = Table({name: tuple(values) for name, values in columns_of(runs).items()}, units=units)
        self.record = {"runs": runs}

    def _store(self) -> Store | None:
        return open_store(self._cache) if self._cache is not None else None

    def _about(self) -> str:
        return str(self._plan.configuration.file.absolute())

    def __repr__(self) -> str:
        rows = "" if self.table is None else f", {self.table.rows} runs"
        return f"<Run {self._plan.name}{rows}: {', '.join(self)}>"

    def _repr_html_(self) -> str:
        if self.table is not None:
            return self.table._repr_html_()
        rows = "".join(
            f"<tr><th>{escaped(name)}</th><td>{escaped(shown(value))}</td></tr>"
            for name, value in list(self.numbers.items())[:MAX_NUMBERS]
        )
        return f"{self._live()}<table><caption>{escaped(self._plan.name)}</caption>{rows}</table>"

    def _live(self) -> str:
        """The live view of the last field that the browser can sum itself; empty if there is none."""
        for step in reversed(self._plan.until(self._until)):
            viewer = next((viewer for made in step.makes if (viewer := viewer_of(made)) and viewer.frame), None)
            if viewer is not None:
                return str(viewer.maker("frame")(self[step.id]))
        return ""


MAX_NUMBERS = 200
"""Numbers of a run that notebooks show."""
