"""Sweeps: one run for each row of parameter values, each in a folder of its own, and one table of all their numbers."""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.files import clear
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.session import Session
from sppm_pipeline.engine.process.activity import overdue, overdue_file
from sppm_pipeline.engine.process.budget import MEMORY
from sppm_pipeline.engine.process.containment import CONTRACT, STAGE_TIME
from sppm_pipeline.engine.run.events import Monitor, Observers
from sppm_pipeline.engine.run.executors import WorkerOptions, make_executor, serve
from sppm_pipeline.engine.run.outputs import SWEEP_RUNS, remove_stale_runs, staging_name
from sppm_pipeline.engine.run.record import Recorder, mark_ended, movable
from sppm_pipeline.engine.run.rows import dead_row, ended_row, failed_row, overdue_error, run_row, store_in
from sppm_pipeline.engine.run.runner import StepRunner
from sppm_pipeline.engine.run.sweep_table import columns_of, csv_metadata, csv_text, rows_of
from sppm_pipeline.engine.run.workers import announced
from sppm_pipeline.engine.strict_json import json_text
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, SppmError, described

if TYPE_CHECKING:
    from sppm_pipeline.nouns.table import Table

IN_FLIGHT = 64
"""Rows that an executor holds at least, or four for each worker: a heuristic.

Fewer may let workers wait for this process; more only delay an interrupt. A factor of two changes neither noticeably.
"""


def run_sweep(
    session: Session,
    plan: Plan,
    path: Path,
    options: WorkerOptions = WorkerOptions(),  # noqa: B008 - frozen
    *,
    until: str | None = None,
    monitor: Monitor | None = None,
) -> dict[str, Any]:
    """Run all rows, then the stages of `after`, and write ``sweep.csv``, its metadata, ``sweep.json`` and ``run.json``.

    Row i runs in ``runs/<i>`` of the run directory; `plan` is that of the configuration without a row. A row whose
    worker died is run again alone. With `until`, `after` is left out. Without a cache, rows that an interrupted sweep
    had finished run again, too.

    Returns the record, whose `runs` lists the rows; rows that fail do not raise. An `SppmError` says what stopped the
    sweep before any row had ended, after its table has been written; its attribute ``record`` holds the record.
    """
    monitor = monitor or Monitor()
    rows = session.rows
    # a wrong --until fails before any row has run
    plan.until(until)
    with Recorder(plan, path, threads=options.threads, until=until, monitor=monitor) as recorder:
        recorder.extra["runs"] = runs = []
        digits = max(4, len(str(len(rows) - 1)))
        names = [f"{i:0{digits}}" for i in range(len(rows))]
        found, stopped = _run_rows(session, path, names, options, until, monitor)
        found = movable(found, plan, path)
        # rows of an earlier, longer sweep would be taken for results of this one
        remove_stale_runs(path, names)
        columns = columns_of(found)
        runs += [
            {key: value for key, value in run.items() if key not in ("columns", "files", "units")} for run in found
        ]
        units = {name: unit for run in reversed(found) for name, unit in run["units"].items()}
        recorder.extra["outputs"] = [
            recorder.folder.add_file("sweep.csv", csv_text(columns)),
            recorder.folder.add_file("sweep.json", json_text(rows_of(columns))),
            recorder.folder.add_file("sweep.csv-metadata.json", json_text(csv_metadata(columns, units))),
        ]
        # the table is there by now, whatever stopped the sweep
        if stopped is not None:
            raise stopped
        done = [run["status"] == "done" for run in runs]
        # stages of `after` read the table, with gaps where a row failed
        if plan.after and until is None and any(done):
            StepRunner(
                steps=plan.after,
                recipes=plan.recipes,
                seed=plan.seed,
                threads=options.threads,
                folder=recorder.folder,
                monitor=monitor,
                observers=Observers([recorder, monitor], plan.plugins, recorder.warn),
                available={SWEEP_ID: _table(columns, found, path)},
                store=store_in(options.cache),
                checkpoint=recorder.checkpoint,
            ).run()
        recorder.status = "done" if all(done) else "failed"
    return recorder.record


def _table(columns: Mapping[str, Sequence[Any]], runs: Sequence[Mapping[str, Any]], path: Path) -> Table:
    """The table for the stages of `after`, with the files that the runs wrote."""
    from sppm_pipeline.nouns.table import RunFile, Table

    folders = [path.absolute() / SWEEP_RUNS / run["run"] for run in runs]
    names = dict.fromkeys(name for run in runs for name in run["files"])
    files = {
        name: tuple(
            RunFile(str(folder / name), run["files"][name]) if name in run["files"] else None
            for folder, run in zip(folders, runs, strict=True)
        )
        for name in names
    }
    return Table({name: tuple(values) for name, values in columns.items()}, files)


def _run_rows(
    session: Session, path: Path, names: Sequence[str], options: WorkerOptions, until: str | None, monitor: Monitor
) -> tuple[list[dict[str, Any]], SppmError | None]:
    """Hand the rows to an executor; results in the order of the rows, and what stopped it before any row had ended.

    Where a worker process dies, the rows that were running are run again, each alone: a row that takes its process down
    each time has failed, and the others go on. What stops the sweep as a whole is the error of the rows that are left.
    """
    path = path.resolve()
    stopped: SppmError | None = None
    results: dict[int, dict[str, Any]] = {}
    again: dict[int, int] = {}  # how often a row was run once more
    suspects: set[int] = set()
    tasks: list[dict[str, Any]] = []

    def ended(number: int, result: dict[str, Any]) -> None:
        results[number] = result | {"attempts": 1 + again.get(number, 0)}
        notes = Path(tasks[number]["notes"])
        for file in (notes, overdue_file(notes)):
            with contextlib.suppress(OSError):  # there is none of a row that ran in this process
                file.unlink()
        monitor.row_finished(len(results), len(names), result)

    def end_overdue(numbers: Iterable[int]) -> bool:
        """Take in the rows that were ended because a stage had used up its time: they would do so again."""
        late = {n: now for n in numbers if (now := overdue(Path(tasks[n]["notes"]))) is not None}
        for number, now in late.items():
            ended(number, ended_row(session, tasks[number], overdue_error(now)))
        return bool(late)

    def failed(number: int, error: BaseException) -> None:
        if end_overdue([number]):
            return
        if isinstance(error, NativeCrash):
            suspects.add(number)
        elif isinstance(error, SppmError):
            raise error
        else:
            text = f"the executor {options.name!r} lost run {names[number]!r}: {described(error)}"
            ended(number, failed_row(session, tasks[number], PluginError(text)))

    def serve_rows(workers: int, left: Mapping[int, Mapping[str, Any]]) -> tuple[BaseException | None, list[int]]:
        # a new one each time: after a worker died, pools of processes take no more tasks
        pool = make_executor(options.name, workers, session.plugins)
        if len(left) == len(tasks):
            monitor.sweep_started(getattr(pool, "about", ""), len(tasks))
        if hasattr(pool, "notify"):
            pool.notify = lambda message: monitor.warning(None, message)
        return serve(pool, run_row, left, ended, failed, most=max(IN_FLIGHT, 4 * workers))

    def alone(number: int) -> None:
        codes: list[int] = []
        # alone, a row can take down no other, and its death is its own
        for _ in range(options.retries):
            suspects.discard(number)
            again[number] = again.get(number, 0) + 1
            broken, codes = serve_rows(1, {number: tasks[number]})
            if number in results or end_overdue([number]):
                return
            if broken is None and number not in suspects:
                break
        suspects.discard(number)
        ended(number, dead_row(session, tasks[number], codes))

    try:
        with (
            _notes_folder(path) as folder,
            announced(path, options, session.plugins) as driver,
        ):
            common = {
                "request": session.request.absolute(),
                "sweep": uuid.uuid4().hex,
                "threads": options.threads_each,
                "until": until,
                "cache": None if options.cache is None else options.cache.resolve(),
                "from": os.getpid(),
                "driver": driver,
                "limits": {name: os.environ.get(name) for name in (STAGE_TIME, MEMORY, CONTRACT)},
            }
            tasks += [
                {**common, "row": i, "path": str(path / SWEEP_RUNS / name), "notes": str(folder / name)}
                for i, name in enumerate(names)
            ]
            while left := {i: task for i, task in enumerate(tasks) if i not in results}:
                broken, _ = serve_rows(options.workers, left)
                if broken is not None and not end_overdue(left.keys() - results.keys()):
                    # those that had begun when the pool broke: one of them, or the machine, is the cause
                    begun = {i for i, task in left.items() if i not in results and Path(task["notes"]).exists()}
                    if not (begun or suspects):
                        raise NativeCrash(
                            f"{_why(broken)}; {len(results)} of {len(tasks)} runs had ended",
                            hint="a native library crashed, or memory ran out; try fewer workers with -j, or "
                            "--executor serial",
                        )
                    # rows that had not begun go on with the others
                    suspects |= begun
                for number in sorted(suspects):
                    alone(number)
    except SppmError as error:
        if not tasks:
            raise
        if results:
            monitor.warning(None, f"the sweep ended early: {error.message}")
        else:
            stopped = error
        for number, task in enumerate(tasks):
            if number not in results:
                results[number] = failed_row(session, task, error) | {"attempts": again.get(number, 0)}
    finally:
        # no row may be left as running
        for name in names:
            mark_ended(path / SWEEP_RUNS / name)
    return [results[number] for number in range(len(names))], stopped


@contextlib.contextmanager
def _notes_folder(path: Path) -> Iterator[Path]:
    """A folder in the run directory, which workers on other machines see, for the files that workers share."""
    folder = path / staging_name()
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise ResourceError(f"can't write into {str(path)!r}: {error.strerror}") from error
    try:
        yield folder
    finally:
        clear(folder)


def _why(broken: BaseException) -> str:
    from concurrent.futures.process import BrokenProcessPool

    return "a worker process died before it began a run" if isinstance(broken, BrokenProcessPool) else str(broken)
