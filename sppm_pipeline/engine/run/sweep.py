"""Sweeps: one run for each row of parameter values, each in a folder of its own, and one table of all their numbers."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import signal
import socket
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.document import plain
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.session import Row, RunRequest, Session, open_session
from sppm_pipeline.engine.process.activity import current, of_run, share
from sppm_pipeline.engine.run.events import Monitor, Observers
from sppm_pipeline.engine.run.executors import default_executor, make_executor, serve
from sppm_pipeline.engine.run.outputs import RECORD, SWEEP_RUNS, remove_stale_runs
from sppm_pipeline.engine.run.record import Recorder, error_entry, mark_ended
from sppm_pipeline.engine.run.runner import StepRunner, run_plan
from sppm_pipeline.engine.run.sweep_table import columns_of, csv_text, numbers_of, rows_of
from sppm_pipeline.engine.run.workers import Driver, announced, check_worker
from sppm_pipeline.engine.strict_json import json_text
from sppm_pipeline.errors import NativeCrash, PluginError, SppmError

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store
    from sppm_pipeline.nouns.table import Table

IN_FLIGHT = 64
"""Rows that an executor holds at least, or four for each worker: it never waits, and canceling is instant; a choice."""

RETRIES = 2
"""How often a row whose worker died is run again unless said otherwise; a choice."""


def run_sweep(
    session: Session,
    plan: Plan,
    path: Path,
    *,
    workers: int,
    executor: str | None,
    threads: int,
    until: str | None = None,
    monitor: Monitor | None = None,
    cache: Path | None = None,
    retries: int = RETRIES,
    same_processor: bool = False,
) -> dict[str, Any]:
    """Run all rows, then the stages of `after`, and write ``sweep.csv``, ``sweep.json`` and ``run.json``.

    Parameters
    ----------
    session : Session
    plan : Plan
        The plan of the configuration without a row.
    path : Path
        The run directory; row i runs in ``runs/<i>`` in it.
    workers : int
        Runs at the same time.
    executor : str or None
        See `make_executor`.
    threads : int
        Threads of all workers together.
    until : str, optional
        Id of the last stage to run; `after` is then left out.
    monitor : Monitor, optional
    cache : Path, optional
        Folder of the cache; without one every row runs, also those that an interrupted sweep had finished.
    retries : int
        How often a row whose worker died is run again, alone.
    same_processor : bool
        Refuse workers on another kind of processor, whose last digits may differ.

    Returns
    -------
    dict
        The record; its `runs` lists the rows. Rows that fail do not raise.

    Raises
    ------
    SppmError
        What stopped the sweep before any row had ended, after its table has been written; its attribute ``record``
        holds the record.
    """
    monitor = monitor or Monitor()
    rows = session.rows
    plan.until(until)
    asked = _Asked(
        workers=workers,
        executor=executor or default_executor(workers),
        threads=max(1, threads // workers),
        until=until,
        cache=None if cache is None else cache.resolve(),
        retries=retries,
        same_processor=same_processor,
    )
    with Recorder(plan, path, threads=threads, until=until, monitor=monitor) as recorder:
        recorder.extra["runs"] = runs = []
        names = _row_names(len(rows))
        found, stopped = _run_rows(session, path, names, asked, monitor)
        remove_stale_runs(path, names)
        columns = columns_of(found)
        runs += [{key: value for key, value in run.items() if key not in ("columns", "files")} for run in found]
        recorder.extra["outputs"] = [
            recorder.folder.add_file("sweep.csv", csv_text(columns)),
            recorder.folder.add_file("sweep.json", json_text(rows_of(columns))),
        ]
        if stopped is not None:
            raise stopped
        done = [run["status"] == "done" for run in runs]
        if plan.after and until is None and any(done):
            StepRunner(
                plan.after,
                plan.recipes,
                seed=plan.seed,
                threads=threads,
                folder=recorder.folder,
                monitor=monitor,
                observers=Observers([recorder, monitor], plan.plugins, recorder.warn),
                available={SWEEP_ID: _table(columns, found, path)},
                store=_store(cache),
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


def _files(record: Mapping[str, Any]) -> dict[str, str]:
    """Digests of the files that a run wrote, by name; folders are left out."""
    outputs = [output for stage in record.get("stages", ()) for output in stage.get("outputs", ())]
    return {output["path"]: output["sha256"] for output in outputs if "files" not in output}


def _row_names(count: int) -> list[str]:
    """Folders of the rows."""
    digits = max(4, len(str(count - 1)))
    return [f"{i:0{digits}}" for i in range(count)]


def _store(cache: Path | None) -> Store | None:
    if cache is None:
        return None
    from sppm_pipeline.engine.cache.housekeeping import open_store

    return open_store(cache)


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """How rows are to be run; see `run_sweep`.

    Attributes
    ----------
    executor : str
        Also of rows that are run alone.
    threads : int
        Of each worker.
    """

    workers: int
    executor: str
    threads: int
    until: str | None
    cache: Path | None
    retries: int
    same_processor: bool


def _run_rows(
    session: Session, path: Path, names: Sequence[str], asked: _Asked, monitor: Monitor
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
        with contextlib.suppress(OSError):  # there is none of a row that ran in this process
            Path(tasks[number]["notes"]).unlink()
        monitor.row_finished(len(results), len(names), result)

    def failed(number: int, error: BaseException) -> None:
        if isinstance(error, NativeCrash):
            suspects.add(number)
        elif isinstance(error, SppmError):
            raise error
        else:
            text = f"the executor {asked.executor!r} lost run {names[number]!r}: {type(error).__name__}: {error}"
            ended(number, _failed(session, tasks[number], PluginError(text)))

    def serve_rows(workers: int, left: Mapping[int, Mapping[str, Any]]) -> tuple[BaseException | None, list[int]]:
        pool = make_executor(asked.executor, workers, session.plugins)
        if len(left) == len(tasks):
            monitor.sweep_started(getattr(pool, "about", ""), len(tasks))
        return serve(pool, run_row, left, ended, failed, most=max(IN_FLIGHT, 4 * workers))

    def alone(number: int) -> None:
        codes: list[int] = []
        for _ in range(asked.retries):
            suspects.discard(number)
            again[number] = again.get(number, 0) + 1
            broken, codes = serve_rows(1, {number: tasks[number]})
            if number in results:
                return
            if broken is None and number not in suspects:
                break
        suspects.discard(number)
        ended(number, _taken_down(session, tasks[number], codes))

    try:
        with (
            TemporaryDirectory(prefix="sppm-sweep-") as folder,
            announced(path, asked.cache, session.plugins, same_processor=asked.same_processor) as driver,
        ):
            common = {
                "request": session.request.absolute(),
                "sweep": uuid.uuid4().hex,
                "threads": asked.threads,
                "until": asked.until,
                "cache": asked.cache,
                "from": os.getpid(),
                "driver": driver,
            }
            tasks += [
                {**common, "row": i, "path": str(path / SWEEP_RUNS / name), "notes": str(Path(folder) / name)}
                for i, name in enumerate(names)
            ]
            while left := {i: task for i, task in enumerate(tasks) if i not in results}:
                broken, _ = serve_rows(asked.workers, left)
                if broken is not None:
                    begun = {i for i, task in left.items() if i not in results and Path(task["notes"]).exists()}
                    if not (begun or suspects):
                        raise NativeCrash(
                            f"{_why(broken)}; {len(results)} of {len(tasks)} runs had ended",
                            hint="a native library crashed, or memory ran out; try fewer workers with -j, or "
                            "--executor serial",
                        )
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
                results[number] = _failed(session, task, error) | {"attempts": again.get(number, 0)}
    finally:
        for name in names:
            mark_ended(path / SWEEP_RUNS / name)
    return [results[number] for number in range(len(names))], stopped


def _why(broken: BaseException) -> str:
    from concurrent.futures.process import BrokenProcessPool

    return "a worker process died before it began a run" if isinstance(broken, BrokenProcessPool) else str(broken)


def _failed(session: Session, task: Mapping[str, Any], error: SppmError) -> dict[str, Any]:
    """The result of a row that did not run, or of which nothing was heard."""
    return _result(Path(task["path"]), session.rows[task["row"]], {}, error_entry(error))


def _taken_down(session: Session, task: Mapping[str, Any], codes: Sequence[int]) -> dict[str, Any]:
    """The result of a row whose process has died, by what it was doing."""
    path, notes = Path(task["path"]), Path(task["notes"])
    now = current(notes) if notes.exists() else None  # it ran on another machine
    place: dict[str, Any] = {} if now is None else {"where": now.place, "stage": now.stage or None}
    doing = "" if now is None else f", while this was running: {now.what}"
    code = codes[0] if len(codes) == 1 else None
    run = f"the process of run {path.name!r}"
    error: SppmError
    if code is not None and code >= 0:
        kind = SppmError if now is None or now.builtin else PluginError
        error = kind(f"{run} was ended by its own code (exit code {code}){doing}", **place)
    else:
        name = f" by {signal.Signals(-code).name}" if code else ""
        memory = ", perhaps because memory ran out" if code == -signal.SIGKILL else ""
        hint = "run this row alone with --debug; if memory ran out, try a coarser resolution"
        error = NativeCrash(f"{run} was taken down{name}{memory}{doing}", hint=hint, **place)
    mark_ended(path, "failed", error)
    try:
        record = json.loads((path / RECORD).read_bytes())
    except (OSError, ValueError):
        record = {}
    row = session.rows[task["row"]]
    return _result(path, row, record, record.get("error") or error_entry(error))


@functools.lru_cache(maxsize=1)
def _session(request: RunRequest, sweep: str) -> Session:
    """One session a sweep and worker process, whatever the number of its rows."""
    return open_session(request)


def run_row(task: Mapping[str, Any]) -> dict[str, Any]:
    """Run one row of a sweep; errors are returned, not raised.

    Parameters
    ----------
    task : mapping
        ``request`` (a `RunRequest`), ``sweep`` (a string that no other sweep has), ``row`` (number of the row),
        ``path`` (run directory), ``threads``, ``until``, ``cache`` (folder of the cache, or None), ``notes`` (a file in
        which a worker process notes what it is doing), ``from`` (number of the process that has made the task) and
        ``driver`` (a `Driver`).

    Returns
    -------
    dict
        ``run``, ``params``, ``status``, ``error``, ``seconds``, ``host``, ``warnings``, ``columns``, ``files`` (names
        and digests), and as ``record`` the digest of the row's record.

    Raises
    ------
    ConfigError, ResourceError
        If this worker process is unfit for the sweep; see `check_worker`.
    """
    driver: Driver = task["driver"]
    apart = (os.getpid(), socket.gethostname()) != (task["from"], driver.host)
    warnings = check_worker(driver) if apart else []
    session = _session(task["request"], task["sweep"])
    row = session.rows[task["row"]]
    path = Path(task["path"])
    if apart:
        with contextlib.suppress(OSError):  # on another machine
            share(Path(task["notes"]))
    try:
        from sppm_pipeline.engine.cache.keys import run_key

        plan, store = session.plan(row), _store(task["cache"])
        key = run_key(plan, task["until"])
        with contextlib.nullcontext() if apart else of_run(path.name):  # of a worker process its notes tell
            record = run_plan(plan, path, threads=task["threads"], until=task["until"], store=store, key=key)
        error = None
    except SppmError as raised:
        record, error = getattr(raised, "record", {}), error_entry(raised)
    result = _result(path, row, record, error)
    return result | {"host": socket.gethostname(), "warnings": warnings + result["warnings"]}


def _result(path: Path, row: Row, record: Mapping[str, Any], error: Mapping[str, Any] | None) -> dict[str, Any]:
    """What the sweep keeps of a row, from its record."""
    return {
        "run": path.name,
        "params": {name: plain(entry.node) for name, entry in row.items()},
        "status": "done" if error is None else "failed",
        "error": error,
        "seconds": record.get("seconds"),
        "warnings": _warnings(record),
        "columns": numbers_of(record.get("stages", ())),
        "files": _files(record),
        "record": record.get("sha256"),
    }


def _warnings(record: Mapping[str, Any]) -> list[str]:
    """Warnings of all stages of a run."""
    return [
        f"stage {stage['id']!r}: {message}"
        for stage in record.get("stages", ())
        for message in stage.get("warnings", ())
    ]
