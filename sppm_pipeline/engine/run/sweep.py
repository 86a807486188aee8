"""Sweeps: one run for each row of parameter values, each in a folder of its own, and one table of all their numbers."""

from __future__ import annotations

import contextlib
import csv
import functools
import io
import json
import os
import signal
import sys
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.document import plain
from sppm_pipeline.engine.config.parameters import sweep_rows
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.session import Row, RunRequest, Session, check_sweep, check_until, open_session
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import default_executor, make_executor
from sppm_pipeline.engine.run.outputs import RECORD, SWEEP_RUNS, remove_stale_runs
from sppm_pipeline.engine.run.record import Recorder, error_entry, mark_ended
from sppm_pipeline.engine.run.runner import StepRunner, run_plan
from sppm_pipeline.engine.strict_json import json_text
from sppm_pipeline.errors import NativeCrash, PluginError, SppmError
from sppm_pipeline.process.activity import current, share
from sppm_pipeline.process.interruption import check

if TYPE_CHECKING:
    from concurrent.futures import Executor, Future

    from sppm_pipeline.data.table import Table
    from sppm_pipeline.engine.cache.store import Store

LISTENING = 0.25
"""Seconds between two looks at whether the sweep was asked to stop."""


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

    Returns
    -------
    dict
        The record; its `runs` lists the rows. Rows that fail do not raise.

    Raises
    ------
    SppmError
        What stopped the sweep as a whole; its attribute ``record`` holds the record.
    """
    monitor = monitor or Monitor()
    check_until(plan, until)
    rows = _rows(session)
    check_sweep(session, rows, until)
    with Recorder(plan, path, threads=threads, until=until, monitor=monitor) as recorder:
        recorder.extra["runs"] = runs = []
        names = _row_names(len(rows))
        found = _run_rows(session, path, names, workers, executor, max(1, threads // workers), until, monitor, cache)
        remove_stale_runs(path, names)
        columns = columns_of(found)
        runs += [{key: value for key, value in run.items() if key not in ("columns", "files")} for run in found]
        recorder.extra["outputs"] = [
            recorder.folder.add_file("sweep.csv", csv_text(columns)),
            recorder.folder.add_file("sweep.json", json_text(rows_of(columns))),
        ]
        done = [run["status"] == "done" for run in runs]
        if plan.after and until is None and any(done):
            StepRunner(
                plan.after,
                plan.recipes,
                seed=plan.seed,
                threads=threads,
                folder=recorder.folder,
                monitor=monitor,
                observers=recorder.observers(),
                available={SWEEP_ID: _table(columns, found, path)},
                store=_store(cache),
                checkpoint=recorder.checkpoint,
            ).run()
        recorder.status = "done" if all(done) else "failed"
    return recorder.record


def _table(columns: Mapping[str, Sequence[Any]], runs: Sequence[Mapping[str, Any]], path: Path) -> Table:
    """The table for the stages of `after`, with the files that the runs wrote."""
    from sppm_pipeline.data.table import RunFile, Table

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


def _run_rows(
    session: Session,
    path: Path,
    names: Sequence[str],
    workers: int,
    executor: str | None,
    threads: int,
    until: str | None,
    monitor: Monitor,
    cache: Path | None,
) -> list[dict[str, Any]]:
    """Hand the rows to an executor; results in the order of the rows.

    Where a worker process dies, the rows that were running are run again, each alone: a row that takes its process down
    once more has failed, and the others go on.
    """
    common = {
        "request": session.request.absolute(),
        "sweep": uuid.uuid4().hex,
        "threads": threads,
        "until": until,
        "cache": cache,
    }
    executor = executor or default_executor(workers)  # also of rows that are run alone
    results: dict[int, dict[str, Any]] = {}
    notes: list[Path] = []

    def ended(number: int, result: dict[str, Any]) -> None:
        results[number] = result
        with contextlib.suppress(OSError):  # there is none of a row that ran in this process
            notes[number].unlink()
        monitor.row_finished(len(results), len(names), result)

    try:
        with TemporaryDirectory(prefix="sppm-sweep-") as folder:
            notes += [Path(folder) / name for name in names]
            tasks = [
                {**common, "row": i, "path": str(path / SWEEP_RUNS / name), "notes": str(notes[i]), "from": os.getpid()}
                for i, name in enumerate(names)
            ]
            while left := {i: task for i, task in enumerate(tasks) if i not in results}:
                if not _serve(make_executor(executor, workers, session.plugins), left, ended)[0]:
                    break
                running = {i: task for i, task in left.items() if i not in results and notes[i].exists()}
                if not running:
                    raise NativeCrash(
                        f"a worker process died before it began a run; {len(results)} of {len(tasks)} runs had ended",
                        hint="a native library crashed, or memory ran out; try fewer workers with -j, or "
                        "--executor serial",
                    )
                for i, task in running.items():
                    died, codes = _serve(make_executor(executor, 1, session.plugins), {i: task}, ended)
                    if died:
                        ended(i, _taken_down(session, task, notes[i], codes))
    finally:
        for name in names:
            mark_ended(path / SWEEP_RUNS / name)
    return [results[number] for number in range(len(names))]


def _serve(
    pool: Executor, tasks: Mapping[int, Mapping[str, Any]], ended: Callable[[int, dict[str, Any]], None]
) -> tuple[bool, list[int]]:
    """Run rows until all have ended or a worker process has died.

    Returns
    -------
    died : bool
        Whether one has.
    codes : list of int
        The exit codes of worker processes, negative for a signal; those of other machines are not known.
    """
    from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait

    before, workers = set(_children()), []
    futures: dict[Future[dict[str, Any]], int] = {}
    died = False
    try:
        for number, task in tasks.items():
            check()
            try:
                futures[pool.submit(run_row, task)] = number
            except BrokenExecutor:
                died = True
                break
        workers = [process for process in _children() if process not in before]
        waiting = set(futures)
        while waiting:
            # not for ever, so that whoever is asked to stop hears of it
            done, waiting = wait(waiting, timeout=LISTENING, return_when=FIRST_COMPLETED)
            check()
            for future in sorted(done, key=lambda f: futures[f]):
                if isinstance(future.exception(), BrokenExecutor):
                    died = True
                else:
                    ended(futures[future], future.result())
    except BaseException:
        _stop_workers()
        raise
    finally:
        for future in futures:  # `shutdown` of a cluster's executor may not know how to
            future.cancel()
        pool.shutdown(wait=True)
    return died, [process.exitcode for process in workers if process.exitcode is not None]


def _taken_down(session: Session, task: Mapping[str, Any], notes: Path, codes: Sequence[int]) -> dict[str, Any]:
    """The result of a row whose process has died, by what it was doing."""
    path, now = Path(task["path"]), current(notes)
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
    row = _rows(session)[task["row"]]
    return _result(path, row, record, record.get("error") or error_entry(error))


def _children() -> list[Any]:
    return sys.modules["multiprocessing"].active_children() if "multiprocessing" in sys.modules else []


def _stop_workers() -> None:
    """End the processes of this sweep, so that an interrupted one does not go on in the background.

    Runs in threads do not hear of the interruption; the native code that they wait for is ended for them.
    """
    for process in _children():
        process.terminate()
    if "sppm_pipeline.process.native" in sys.modules:
        sys.modules["sppm_pipeline.process.native"].stop_all()


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
        which a worker process notes what it is doing) and ``from`` (number of the process that has made the task).

    Returns
    -------
    dict
        ``run``, ``params``, ``status``, ``error``, ``seconds``, ``warnings``, ``columns``, ``files`` (names and
        digests), and as ``record`` the digest of the row's record.
    """
    session = _session(task["request"], task["sweep"])
    row = _rows(session)[task["row"]]
    path = Path(task["path"])
    if os.getpid() != task["from"]:
        with contextlib.suppress(OSError):  # on another machine
            share(Path(task["notes"]))
    try:
        from sppm_pipeline.engine.cache.keys import run_key

        plan, store = session.plan(row), _store(task["cache"])
        key = run_key(plan, task["until"])
        record = run_plan(plan, path, threads=task["threads"], until=task["until"], store=store, key=key)
    except SppmError as error:
        return _result(path, row, getattr(error, "record", {}), error_entry(error))
    return _result(path, row, record, None)


def _rows(session: Session) -> Sequence[Row]:
    assert session.configuration.sweep is not None
    return sweep_rows(session.configuration.sweep, session.configuration.params)


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


MAX_LISTED = 6
"""Longest list whose numbers get columns of their own: vectors, and the rows and columns of a stiffness matrix."""


def numbers_of(stages: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Numbers in the summaries of a run record's stages, as ``<stage id>.<name>``; truth values as 1 and 0.

    Those of short lists are counted from 1, row by row: ``E.1``, ``C.4.4``.
    """
    return {f"{stage['id']}.{name}": value for stage in stages for name, value in _numbers(stage.get("summary", {}))}


def _numbers(summary: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in summary.items():
        if isinstance(value, (bool, int, float)):
            yield name, int(value) if isinstance(value, bool) else value
        elif isinstance(value, dict):
            yield from ((f"{name}.{inner}", number) for inner, number in _numbers(value))
        elif isinstance(value, list) and len(value) <= MAX_LISTED:
            listed = {str(number): one for number, one in enumerate(value, 1) if not isinstance(one, dict)}
            yield from ((f"{name}.{inner}", number) for inner, number in _numbers(listed))


def columns_of(runs: Sequence[Mapping[str, Any]]) -> dict[str, list[Any]]:
    """Columns ``run``, the parameters, ``status``, ``error``, then the numbers in the order in which they appear.

    Parameters
    ----------
    runs : sequence of dict
        With the keys run, params, status, error and columns, in order.
    """
    params = list(dict.fromkeys(name for run in runs for name in run["params"]))
    numbers = list(dict.fromkeys(name for run in runs for name in run["columns"]))
    columns: dict[str, list[Any]] = {"run": [run["run"] for run in runs]}
    columns |= {name: [run["params"].get(name) for run in runs] for name in params}
    columns["status"] = [run["status"] for run in runs]
    columns["error"] = [run["error"]["message"] if run["error"] else None for run in runs]
    return columns | {name: [run["columns"].get(name) for run in runs] for name in numbers}


def rows_of(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """The table as a list of rows."""
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def csv_text(columns: Mapping[str, Sequence[Any]]) -> str:
    """The table as CSV; lists as JSON, nothing as an empty field."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    for row in rows_of(columns):
        writer.writerow([json.dumps(v) if isinstance(v, (list, dict, bool)) else v for v in row.values()])
    return text.getvalue()
