"""The run record on disk: true at every moment, whole or not at all, and last to be written."""

from __future__ import annotations

import contextlib
import datetime
import json
import time
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.jsonable import json_text
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.run.files import write_whole
from sppm_pipeline.engine.run.monitor import Monitor
from sppm_pipeline.engine.run.outputs import RECORD, SWEEP_RUNS, RunFolder
from sppm_pipeline.engine.run.record import error_entry, record_of
from sppm_pipeline.engine.run.sealing import sealed
from sppm_pipeline.errors import NativeCrash, SppmError
from sppm_pipeline.process.interruption import register, requested, unregister


class Recorder:
    """Keeps ``run.json`` of a run directory true: written when the run begins, as it goes on and however it ends.

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
        self.folder = RunFolder(path, threads)
        self.stages: list[dict[str, Any]] = []
        self.extra: dict[str, Any] = {}
        self.status = "done"
        self.record: dict[str, Any] = {}

    def __enter__(self) -> Recorder:
        self.folder.prepare()
        self._began, self._started = datetime.datetime.now(datetime.UTC), time.perf_counter()
        try:
            self._write("running", None)  # from here on the directory is known to be a run's
        except BaseException:
            self.folder.discard()
            raise
        register(self, self.folder.path)
        for message in self._plan.warnings:
            self._monitor.warning(None, message)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        try:
            if requested():  # whatever followed from it
                self._write("interrupted", None)
            elif error is None:
                self.folder.settle()
                self._write(self.status, None)
            elif isinstance(error, SppmError):
                self._write("failed", error)
                error.record = self.record  # type: ignore[attr-defined]
            else:
                self._write("interrupted" if isinstance(error, KeyboardInterrupt) else "failed", None)
        finally:
            unregister(self)
            self.folder.discard()

    def checkpoint(self) -> None:
        """Write down what is finished and which files are about to be put into place.

        Whoever comes after a process that was killed then knows all files that are from this run.
        """
        self._write("running", None)

    def cancel(self, error: SppmError | None) -> None:
        """Say that the run failed or was interrupted, from another thread than its own, which will not end in time."""
        self._write("failed" if error is not None else "interrupted", error)
        self.folder.discard()

    def _write(self, status: str, error: SppmError | None) -> None:
        finished = status != "running"
        extra = dict(self.extra)
        accounted = [output["path"] for stage in self.stages for output in stage.get("outputs", ())]
        accounted += [output["path"] for output in extra.get("outputs", ())]
        if finished and (sums := self.folder.write_sums(accounted)) is not None:
            extra["sums"] = sums
        if earlier := sorted((self.folder.earlier | self.folder.pending()) - set(accounted)):
            extra["earlier"] = earlier
        record = record_of(
            self._plan,
            self.stages,
            status=status,
            error=error,
            started=self._began,
            seconds=time.perf_counter() - self._started,
            threads=self._threads,
            until=self._until,
            extra=extra,
        )
        self.record = sealed(record)
        write_whole(self.folder.path / RECORD, json_text(self.record), durable=finished)


def mark_ended(path: Path, status: str = "interrupted", error: str | None = None) -> None:
    """Put the directory of a run into order whose process was ended, and those of its rows if it is a sweep.

    Nothing is done to runs that had ended by themselves, or that somebody goes on with.

    Parameters
    ----------
    path : Path
        The run directory.
    status : {"interrupted", "failed"}
    error : str, optional
        What took the process down.
    """
    runs = path / SWEEP_RUNS
    for row in sorted(runs.glob("[0-9]*")) if runs.is_dir() else ():
        mark_ended(row)
    try:
        record = json.loads((path / RECORD).read_bytes())
        if record["status"] != "running":
            return
        folder = RunFolder(path)
        folder.prepare()
    except (OSError, ValueError, KeyError, TypeError, SppmError):
        return
    if error is not None:
        record["error"] = error_entry(NativeCrash(error))
    with contextlib.suppress(SppmError):
        write_whole(path / RECORD, json_text(sealed(record | {"status": status})))
    folder.discard()
