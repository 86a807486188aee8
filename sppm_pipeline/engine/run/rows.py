"""One row of a sweep: its run in a worker process, and its result, also if its process is gone."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import signal
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.document import plain
from sppm_pipeline.engine.plan.session import Row, RunRequest, Session, open_session
from sppm_pipeline.engine.process.activity import Activity, of_run, overdue, running, share
from sppm_pipeline.engine.process.containment import set_environment, stage_seconds
from sppm_pipeline.engine.process.guard import guard
from sppm_pipeline.engine.run.events import breaches
from sppm_pipeline.engine.run.outputs import RECORD
from sppm_pipeline.engine.run.record import error_entry, mark_ended
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.sweep_table import numbers_of, units_of
from sppm_pipeline.engine.run.workers import Driver, check_worker
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, SppmError

if TYPE_CHECKING:
    from sppm_pipeline.engine.cache.store import Store


def overdue_error(now: Activity) -> SppmError:
    kind = ResourceError if now.builtin else PluginError
    limit = f"the {seconds:g} seconds that a stage may take" if (seconds := stage_seconds()) else "its stage time"
    hint = "allow more with --stage-time; it could not be interrupted, so its process was ended"
    return kind(f"{now.what} took longer than {limit}", hint=hint, where=now.place, stage=now.stage or None)


def failed_row(session: Session, task: Mapping[str, Any], error: SppmError) -> dict[str, Any]:
    """The result of a row that did not run, or of which nothing was heard."""
    return _result(Path(task["path"]), session.rows[task["row"]], {}, error_entry(error))


def dead_row(session: Session, task: Mapping[str, Any], codes: Sequence[int]) -> dict[str, Any]:
    """The result of a row whose process has died, by what it was doing."""
    path, notes = Path(task["path"]), Path(task["notes"])
    now, doing, place = running(notes) if notes.exists() else (None, "", {})  # it ran on another machine
    # of several workers it is unknown which one ran the row
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
    return ended_row(session, task, error)


def ended_row(session: Session, task: Mapping[str, Any], error: SppmError) -> dict[str, Any]:
    """The result of a row whose process is gone, with what its record still says."""
    path = Path(task["path"])
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
    """Run one row of a sweep; errors are returned, but for those of a worker that is unfit (`check_worker`).

    The task holds ``request`` (a `RunRequest`), ``sweep`` (a string that no other sweep has), ``row`` (number of the
    row), ``path`` (run directory), ``threads``, ``until``, ``cache`` (folder of the cache, or None), ``notes`` (a file
    in which a worker process notes what it is doing), ``from`` (number of the process that has made the task),
    ``driver`` (a `Driver`) and ``limits`` (environment variables with what a stage may take). The result holds ``run``,
    ``params``, ``status``, ``error``, ``seconds``, ``host``, ``warnings``, ``columns``, ``files`` (names and digests),
    and as ``record`` the digest of the row's record.
    """
    driver: Driver = task["driver"]
    apart = (os.getpid(), socket.gethostname()) != (task["from"], driver.host)
    # another program, library or processor gives other last digits
    warnings = check_worker(driver) if apart else []
    session = _session(task["request"], task["sweep"])
    row = session.rows[task["row"]]
    path = Path(task["path"])
    if apart:
        notes = Path(task["notes"])
        if (now := overdue(notes)) is not None:  # an executor may hand out again what has taken its worker down
            return ended_row(session, task, overdue_error(now)) | {"host": socket.gethostname()}
        set_environment(task["limits"])  # of this worker, which another machine may have started
        with contextlib.suppress(OSError):  # a file system without shared memory; then no guard can watch
            share(notes)
            if stage_seconds() is not None and hasattr(signal, "SIGKILL"):
                guard(notes)
    try:
        from sppm_pipeline.engine.cache.keys import run_key

        plan, store = session.plan(row), store_in(task["cache"])
        key = run_key(plan, task["until"])
        # threads share the page of the main process, so the name of the run is added to what is noted
        with contextlib.nullcontext() if apart else of_run(path.name):  # of a worker process its notes tell
            record = run_plan(plan, path, threads=task["threads"], until=task["until"], store=store, key=key)
        error = None
    except SppmError as raised:
        record, error = getattr(raised, "record", {}), error_entry(raised)
    result = _result(path, row, record, error)
    if record:
        result["units"] = units_of(plan.steps, record.get("stages", ()))
    return result | {"host": socket.gethostname(), "warnings": warnings + result["warnings"]}


def _result(path: Path, row: Row, record: Mapping[str, Any], error: Mapping[str, Any] | None) -> dict[str, Any]:
    """Entries of a row in the record of the sweep."""
    stages = record.get("stages", ())
    outputs = [output for stage in stages for output in stage.get("outputs", ())]
    return {
        "run": path.name,
        "params": {name: plain(entry.node) for name, entry in row.items()},
        "status": "done" if error is None else "failed",
        "error": error,
        "seconds": record.get("seconds"),
        "warnings": [f"stage {one['id']!r}: {message}" for one in stages for message in one.get("warnings", ())],
        "columns": numbers_of(stages),
        "units": {},
        # of a folder there is no single digest
        "files": {output["path"]: output["sha256"] for output in outputs if "files" not in output},
        "record": record.get("sha256"),
        "breaches": breaches(record.get("audit")),
    }


def store_in(cache: Path | None) -> Store | None:
    if cache is None:
        return None
    from sppm_pipeline.engine.cache.housekeeping import open_store

    return open_store(cache)
