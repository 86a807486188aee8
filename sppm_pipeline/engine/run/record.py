"""The run record: what was run, with which versions, and what came of it; true on disk at every moment."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import platform
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import sppm_pipeline
from sppm_pipeline.engine.cache.identity import arithmetic, imported_versions, installed_version
from sppm_pipeline.engine.config.document import RECORD_KEY
from sppm_pipeline.engine.config.options import options_of
from sppm_pipeline.engine.files import write_whole
from sppm_pipeline.engine.plan.planning import Plan, step_options
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.engine.process.interruption import register, requested, unregister
from sppm_pipeline.engine.process.resident import highest
from sppm_pipeline.engine.run.events import Monitor, audited, breaches
from sppm_pipeline.engine.run.outputs import RECORD, SWEEP_RUNS, RunFolder
from sppm_pipeline.engine.strict_json import json_text, sealed
from sppm_pipeline.errors import ResourceError, SppmError
from sppm_pipeline.hookspecs import StageEvent, hookimpl

RECORD_VERSION = 1

Entry = dict[str, Any]
"""Entry of a step in the run record."""

_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "networkx", "pillow")


def record_of(
    plan: Plan,
    stages: Sequence[Mapping[str, Any]],
    *,
    status: str,
    error: SppmError | None,
    started: datetime.datetime,
    seconds: float,
    threads: int,
    until: str | None,
    warnings: Sequence[str],
    extra: Mapping[str, Any] = MappingProxyType({}),
    folder: Path | None = None,
) -> dict[str, Any]:
    """The record as a dict; `config` comes first so that `sppm run run.json` need not read the rest.

    Of a record that will lie in `folder`, no path is absolute.
    """
    steps = [step for group in (plan.steps, plan.after, *plan.recipes.values()) for step in group]
    plugins = {str(step.owner.name): step.owner for step in steps if not step.owner.builtin}
    record: dict[str, Any] = {
        RECORD_KEY: RECORD_VERSION,
        "config": plan.document,
        "name": plan.name,
        "status": status,
        "seed": plan.seed,
        "params": dict(plan.params),
        "file": str(plan.configuration.file),
        "until": until,
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(seconds, 6),
        "peak_memory_mb": peak_memory_mb(),
        "threads": threads,
        "versions": versions()
        | ({} if status == "running" else imported_versions())
        | _installed({name for step in steps for name in step.stage.libraries}),
        "plugins": [
            {"name": name, "distribution": plugin.distribution, "version": plugin.version}
            for name, plugin in plugins.items()
        ],
        "platform": {
            "system": platform.system(),
            "release": platform.release(),
            "machine": platform.machine(),
            "processors": os.cpu_count(),
            **arithmetic(),
        },
        "warnings": list(warnings),
        "error": error_entry(error) if error is not None else None,
    }
    record |= dict(extra) | {"stages": list(stages)}
    return record if folder is None else movable(record, plan, folder)


def movable(value: Any, plan: Plan, folder: Path) -> Any:
    """A record or a part of it without absolute paths: the key `folder` is relative to `folder`, others to that."""
    base, here = str(plan.configuration.folder), os.path.abspath(folder)
    steps = [step for group in (plan.steps, plan.after, *plan.recipes.values()) for step in group]
    values = [getattr(step.stage, name) for step in steps for name in options_of(type(step.stage))]
    names = {*map(str, (value for value in values if isinstance(value, Path))), *map(str, plan.configuration.plugins)}
    names.add(os.path.abspath(plan.configuration.file))
    moved = {name: _relative(name, base) for name in names if os.path.isabs(name)} | {base: _relative(base, here)}
    return _walked(value, moved, (base, here))


def _walked(value: Any, moved: Mapping[str, str], folders: Collection[str]) -> Any:
    """A value with these strings replaced, and names of these folders cut off wherever they stand in a text."""
    if isinstance(value, str):
        if value in moved:
            return moved[value]
        for place in sorted(folders, key=len, reverse=True):
            value = value.replace(f"{place}{os.sep}", "") if len(place) > 1 else value
        return value
    if isinstance(value, Mapping):
        return {name: _walked(one, moved, folders) for name, one in value.items()}
    return [_walked(one, moved, folders) for one in value] if isinstance(value, (list, tuple)) else value


def _relative(path: str, start: str) -> str:
    try:
        return os.path.relpath(path, start)
    except ValueError:  # another drive of Windows
        return path


def entry_of(step: Step, facts: Mapping[str, Any], seconds: float, memory: float | None, *, cached: bool) -> Entry:
    """Entry of a step in the run record; empty values are left out."""
    entry: Entry = {
        "id": step.id,
        "stage": step.stage.name,
        "made": facts["made"],
        "seconds": round(seconds, 6),
        "peak_memory_mb": memory,
        "cached": cached,
        "summary": facts["summary"],
        "options": step_options(step),
        "inputs": dict(step.inputs),
        "recipes": dict(step.recipes),
        "warnings": [message if at == step.address else f"{at}: {message}" for at, message in facts["warnings"]],
        "outputs": facts["outputs"],
        "inner": facts["inner"],
        "rejected": "rejection" in facts,
    }
    empty: tuple[Any, ...] = ({}, [], False)
    return {name: value for name, value in entry.items() if value not in empty or name == "summary"}


def versions() -> dict[str, str]:
    """Versions of the program and the libraries below it; also of those that a run from the cache did not load."""
    found = {"sppm_pipeline": sppm_pipeline.__version__, "python": platform.python_version()}
    return found | _installed(_LIBRARIES)


def _installed(names: Collection[str]) -> dict[str, str]:
    return {name: version for name in sorted(names) if (version := installed_version(name)) is not None}


def error_entry(error: SppmError) -> dict[str, Any]:
    """An error as records and tables hold it."""
    return {
        "kind": type(error).__name__,
        "message": error.message,
        "hint": error.hint,
        "stage": error.stage,
        "where": str(error.where) if error.where else None,
        "exit_code": error.exit_code,
    }


def peak_memory_mb() -> float | None:
    """Largest resident size of this process so far, MB; None where the system does not tell."""
    peak = highest()
    return round(peak / 1e6, 1) if peak else None


class Recorder:
    """Keeps ``run.json`` of a run directory true: written when the run begins, as it goes on and however it ends.

    `stages` are the entries of finished stages, `extra` further entries, `status` what is said after a good end, and
    `record` what was written last.
    """

    def __init__(self, plan: Plan, path: Path, *, threads: int, until: str | None, monitor: Monitor) -> None:
        self._plan = plan
        self._threads = threads
        self._until = until
        self._monitor = monitor
        self.folder = RunFolder(path, threads)
        self.stages: list[dict[str, Any]] = []
        self.warnings: list[str] = list(plan.warnings)
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
        for message in self.warnings:
            self._monitor.warning(None, message)
        return self

    @hookimpl
    def sppm_stage_finished(self, event: StageEvent) -> None:
        """Keep what the record says of a stage that ended well, or that was rejected and leaves a report."""
        if event.record:
            self.stages.append(dict(event.record))

    def warn(self, message: str) -> None:
        """Keep a warning that is none of a stage, and show it."""
        self.warnings.append(message)
        self._monitor.warning(None, message)

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        try:
            if requested():  # whatever followed from it
                self._write("interrupted", None)
            elif error is None:
                try:
                    self.folder.settle()
                    self._write(self.status, None)
                except SppmError as late:
                    self._write_failed(late)
                    raise
            elif isinstance(error, SppmError):
                self._write_failed(error)
            else:
                self._write("interrupted" if isinstance(error, KeyboardInterrupt) else "failed", None)
        finally:
            unregister(self)
            self.folder.discard()

    def audit(self) -> None:
        """Have plugins compare what the run has made; the verdict goes into the record, a breach is a warning, too."""
        record = {"config": self._plan.document, "stages": self.stages}
        self.extra["audit"] = audit = audited(record, self._plan.plugins, self.warn)
        for text in breaches(audit):
            self.warn(f"audit: {text}")

    def _write_failed(self, error: SppmError) -> None:
        with contextlib.suppress(ResourceError):  # a full disk; what the stage says of it is the better message
            self._write("failed", error)
        error.record = self.record  # type: ignore[attr-defined]

    def checkpoint(self) -> None:
        """Write down what is finished and which files are about to be put into place.

        After a process that was killed, the next run then knows all files that are from this run.
        """
        self._write("running", None)

    def cancel(self, error: SppmError | None) -> None:
        """Say that the run failed or was interrupted, from another thread than its own, which will not end in time."""
        self._write("failed" if error is not None else "interrupted", error)
        self.folder.discard()

    def _write(self, status: str, error: SppmError | None) -> None:
        # a record that will be written again soon need not wait for the disk
        finished = status != "running"
        extra = dict(self.extra)
        accounted = [output["path"] for stage in self.stages for output in stage.get("outputs", ())]
        accounted += [output["path"] for output in extra.get("outputs", ())]
        # the list of digests comes before the record, which holds its digest
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
            warnings=self.warnings,
            extra=extra,
            folder=self.folder.path,
        )
        self.record = sealed(record)
        write_whole(self.folder.path / RECORD, json_text(self.record), durable=finished)


def mark_ended(path: Path, status: str = "interrupted", error: SppmError | None = None) -> None:
    """Put the directory of a run into order whose process was ended, and those of its rows if it is a sweep.

    Nothing is done to runs that had ended by themselves, or that another process goes on with. The status becomes
    "interrupted" or "failed"; `error` is what took the process down.
    """
    runs = path / SWEEP_RUNS
    for row in sorted(runs.glob("[0-9]*")) if runs.is_dir() else ():
        mark_ended(row)
    try:
        record = json.loads((path / RECORD).read_bytes())
        if record["status"] != "running":
            return
        # the lock fails if another process goes on with this run
        folder = RunFolder(path)
        folder.prepare()
    except (OSError, ValueError, KeyError, TypeError, SppmError):
        return
    if error is not None:
        base = os.path.abspath(path / str(record.get("config", {}).get("folder", ".")))
        record["error"] = _walked(error_entry(error), {}, (base, os.path.abspath(path)))
    with contextlib.suppress(SppmError):
        write_whole(path / RECORD, json_text(sealed(record | {"status": status})))
    folder.discard()
