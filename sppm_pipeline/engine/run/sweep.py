"""Sweeps: one run for each row of parameter values, each in a folder of its own, and one table of all their numbers."""

from __future__ import annotations

import functools
import itertools
import math
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.configuration import MAX_SEED
from sppm_pipeline.engine.config.document import Entry, Node, plain
from sppm_pipeline.engine.config.jsonable import json_text
from sppm_pipeline.engine.config.problems import Problems, did_you_mean, shown
from sppm_pipeline.engine.plan.planning import SWEEP_ID, Plan
from sppm_pipeline.engine.plan.session import RunRequest, Session, open_session
from sppm_pipeline.engine.run.executors import make_executor
from sppm_pipeline.engine.run.monitor import Monitor
from sppm_pipeline.engine.run.outputs import SWEEP_RUNS, remove_stale_runs
from sppm_pipeline.engine.run.record import error_entry
from sppm_pipeline.engine.run.recorder import Recorder, mark_ended
from sppm_pipeline.engine.run.runner import check_until, run_plan, run_steps
from sppm_pipeline.engine.run.sweep_table import columns_of, csv_text, numbers_of, rows_of
from sppm_pipeline.errors import ConfigError, NativeCrash, SppmError
from sppm_pipeline.process.interruption import check

if TYPE_CHECKING:
    from sppm_pipeline.data.table import Table
    from sppm_pipeline.engine.cache.store import Store

MAX_ROWS = 100_000

MOST_CHECKED = 1000
"""Rows that are planned before any work."""

LISTENING = 0.25
"""Seconds between two looks at whether the sweep was asked to stop."""

Row = Mapping[str, Entry]


def sweep_rows(sweep: Node, params: Mapping[str, Any]) -> list[dict[str, Entry]]:
    """The rows of a sweep: of a grid with its last parameter changing fastest, of a table as written.

    In a grid, ``{from: 1, to: 50}`` stands for the whole numbers from 1 to 50, ``{from: 0, to: 100, step: 5}`` for
    every fifth.

    Raises
    ------
    ConfigError
        If a parameter is unknown, a list is empty, or there are too many rows.
    """
    problems = Problems()
    rows: list[dict[str, Entry]]
    if isinstance(sweep.value, dict):
        axes = {name: _axis(name, entry, problems) for name, entry in sweep.value.items()}
        count = math.prod(len(axis) for axis in axes.values())
        if count > MAX_ROWS:
            problems.report(f"the sweep has {count} runs; at most {MAX_ROWS} are allowed", sweep.where)
            problems.raise_any()
        rows = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())] if axes else []
    else:
        rows = []
        for node in sweep.value:
            if isinstance(node.value, dict) and node.value:
                rows.append(dict(node.value))
            else:
                problems.report("a row of a sweep is a map of parameters to values", node.where)
    names = [*params, "seed"]
    entries = {(name, id(entry.node)): (name, entry) for row in rows for name, entry in row.items()}
    for name, entry in entries.values():
        value = entry.node.value
        if name not in names:
            hint = did_you_mean(name, names)
            problems.report(f"the sweep varies {name!r}, which is no parameter", entry.where, hint=hint)
        elif name == "seed" and (isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= MAX_SEED):
            problems.report(
                f"a seed is a whole number, at least 0, at most {MAX_SEED}, got {shown(plain(entry.node))}",
                entry.node.where,
            )
    if not rows and not problems.errors:
        problems.report("the sweep has no runs", sweep.where)
    problems.raise_any()
    return rows


def _axis(name: str, entry: Entry, problems: Problems) -> list[Entry]:
    """The values of one parameter of a grid."""
    value, where = entry.node.value, entry.node.where
    if isinstance(value, list) and value:
        return [Entry(entry.where, node) for node in value]
    if isinstance(value, dict):
        ends = {key: inner.node.value for key, inner in value.items()}
        whole = all(isinstance(end, int) and not isinstance(end, bool) for end in ends.values())
        if {"from", "to"} <= set(ends) <= {"from", "to", "step"} and whole:
            step = ends.get("step", 1)
            if step > 0 and 0 <= ends["to"] - ends["from"] < MAX_ROWS * step:
                return [Entry(entry.where, Node(number, where)) for number in range(ends["from"], ends["to"] + 1, step)]
    problems.report(
        f"the sweep of {name!r} must be a list of values, or whole numbers such as {{from: 1, to: 50}}", where
    )
    return []


def check_sweep(session: Session, rows: Sequence[Row]) -> None:
    """Plan with every value that occurs, so that a bad one is found before any work.

    In a grid each value is tried once, with the first values of the other parameters; in a table each row. Of more
    than `MOST_CHECKED` a part is tried.
    """
    sweep = session.configuration.sweep
    first = rows[0]
    problems = Problems()
    if sweep is not None and isinstance(sweep.value, dict):
        rows = [row for row in rows if sum(row[name].node is not first[name].node for name in row) <= 1]
    if len(rows) > MOST_CHECKED:  # of a long range, values spread evenly over it stand for all, both ends among them
        rows = [*rows[: -1 : -(-len(rows) // MOST_CHECKED)], rows[-1]]
    for row in rows:
        try:
            session.plan(row)
        except ConfigError as error:
            problems.add(error)
    problems.raise_any()


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
    assert session.configuration.sweep is not None
    check_until(plan, until)
    rows = sweep_rows(session.configuration.sweep, session.configuration.params)
    check_sweep(session, rows)
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
            run_steps(
                plan.after,
                plan.recipes,
                recorder.stages,
                seed=plan.seed,
                threads=threads,
                until=None,
                folder=recorder.folder,
                monitor=monitor,
                given={SWEEP_ID: _table(columns, found, path)},
                store=_store(cache),
                checkpoint=recorder.checkpoint,
            )
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
    from sppm_pipeline.engine.cache.location import open_store

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
    """Hand the rows to an executor; results in the order of the rows."""
    from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, wait

    order = session.order.absolute()
    common = {"order": order, "sweep": uuid.uuid4().hex, "threads": threads, "until": until, "cache": cache}
    tasks = [{**common, "row": i, "path": str(path / SWEEP_RUNS / name)} for i, name in enumerate(names)]
    pool = make_executor(executor, workers, session.plugins)
    try:
        futures = {}
        for number, task in enumerate(tasks):
            check()
            futures[pool.submit(run_row, task)] = number
        results: dict[int, dict[str, Any]] = {}
        waiting = set(futures)
        while waiting:
            # not for ever, so that whoever is asked to stop hears of it
            ended, waiting = wait(waiting, timeout=LISTENING, return_when=FIRST_COMPLETED)
            check()
            for future in sorted(ended, key=lambda f: futures[f]):
                row = results[futures[future]] = future.result()
                monitor.row_finished(len(results), len(tasks), row)
    except BrokenExecutor as error:
        raise NativeCrash(
            f"a worker process died during the sweep; {len(results)} of {len(tasks)} runs had ended",
            hint="a native library crashed, or memory ran out; try fewer workers with -j, or --executor serial",
        ) from error
    except BaseException:
        _stop_workers()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        for name in names:
            mark_ended(path / SWEEP_RUNS / name)
    return [results[number] for number in range(len(tasks))]


def _stop_workers() -> None:
    """End the processes of this sweep, so that an interrupted one does not go on in the background.

    Runs in threads do not hear of the interruption; the native code that they wait for is ended for them.
    """
    import sys

    if "multiprocessing" in sys.modules:
        for process in sys.modules["multiprocessing"].active_children():
            process.terminate()
    if "sppm_pipeline.process.native" in sys.modules:
        sys.modules["sppm_pipeline.process.native"].stop_all()


@functools.lru_cache(maxsize=1)
def _session(order: RunRequest, sweep: str) -> Session:
    """One session a sweep and worker process, whatever the number of its rows."""
    return open_session(order)


def run_row(task: Mapping[str, Any]) -> dict[str, Any]:
    """Run one row of a sweep; errors are returned, not raised.

    Parameters
    ----------
    task : mapping
        ``order`` (a `RunRequest`), ``sweep`` (a string that no other sweep has), ``row`` (number of the row),
        ``path`` (run directory), ``threads``, ``until`` and ``cache`` (folder of the cache, or None).

    Returns
    -------
    dict
        ``run``, ``params``, ``status``, ``error``, ``seconds``, ``warnings``, ``columns``, ``files`` (names and
        digests), and as ``record`` the digest of the row's record.
    """
    session = _session(task["order"], task["sweep"])
    assert session.configuration.sweep is not None
    row = sweep_rows(session.configuration.sweep, session.configuration.params)[task["row"]]
    path = Path(task["path"])
    result = {"run": path.name, "params": {name: plain(entry.node) for name, entry in row.items()}}
    try:
        from sppm_pipeline.engine.cache.keys import run_key

        plan, store = session.plan(row), _store(task["cache"])
        key = run_key(plan, task["until"])
        record = run_plan(plan, path, threads=task["threads"], until=task["until"], store=store, key=key)
    except SppmError as error:
        record = getattr(error, "record", {})
        return result | {
            "status": "failed",
            "error": error_entry(error),
            "seconds": record.get("seconds"),
            "warnings": _warnings(record),
            "columns": numbers_of(record.get("stages", ())),
            "files": _files(record),
            "record": record.get("sha256"),
        }
    return result | {
        "status": "done",
        "error": None,
        "seconds": record["seconds"],
        "warnings": _warnings(record),
        "columns": numbers_of(record["stages"]),
        "files": _files(record),
        "record": record["sha256"],
    }


def _warnings(record: Mapping[str, Any]) -> list[str]:
    """Warnings of all stages of a run."""
    return [
        f"stage {stage['id']!r}: {message}"
        for stage in record.get("stages", ())
        for message in stage.get("warnings", ())
    ]
