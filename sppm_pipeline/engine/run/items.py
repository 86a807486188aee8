"""One item of work in a worker of a run, and the value that all items have in common, kept no longer than needed."""

from __future__ import annotations

import contextlib
import functools
import importlib
import os
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from sppm_pipeline.engine.files import DISK
from sppm_pipeline.engine.plan.plugin_files import import_file
from sppm_pipeline.engine.run.workers import Driver, check_worker
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.nouns.storage import DamagedError, StoredFile, load_value


class Kept(NamedTuple):
    """Place of a value that all workers load: its folder, and the digests of its files."""

    folder: str
    files: tuple[StoredFile, ...]


@dataclass(frozen=True)
class Task:
    """An item on its way to a worker.

    `function` is ``module:name``, `sender` the process that has made the task, `plugins` are those that are single
    files.
    """

    function: str
    common: Kept | None
    item: Any
    driver: Driver
    sender: int
    plugins: tuple[str, ...]


def name_of(function: Callable[..., Any]) -> str:
    """``module:name`` of a function of a module, by which another process finds it.

    `TypeError` for a method, a lambda, a function inside of another one or of the main script.
    """
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", "")
    if module in (None, "__main__") or getattr(sys.modules.get(str(module)), name, None) is not function:
        raise TypeError(f"what is mapped must be a function of a module that workers can import, not {function!r}")
    return f"{module}:{name}"


def run_item(task: Task) -> tuple[Any, list[str]]:
    """Do one item in a worker; its result and warnings, or the errors of `check_worker`."""
    apart = (os.getpid(), socket.gethostname()) != (task.sender, task.driver.host)
    warnings = check_worker(task.driver) if apart else []
    for file in task.plugins:
        import_file(Path(file))
    module, _, name = task.function.partition(":")
    function = getattr(importlib.import_module(module), name)
    with _at_work():
        common = None if task.common is None else _loaded(task.common)
        return function(common, task.item), warnings


IDLE = 5.0
"""Seconds without an item after which a worker drops the value that items had in common: a heuristic, longer than the
time between two calls of `map`; a factor of two changes memory only."""

_items = 0
_idle: threading.Timer | None = None
_counting = threading.Lock()


@contextlib.contextmanager
def _at_work() -> Iterator[None]:
    """Keep the value that items have in common while one is in work here, and `IDLE` seconds longer."""
    global _items, _idle
    with _counting:
        _items += 1
        if _idle is not None:
            _idle.cancel()
            _idle = None
    try:
        yield
    finally:
        with _counting:
            _items -= 1
            if not _items:
                _idle = threading.Timer(IDLE, _forget_if_idle)
                _idle.daemon = True
                _idle.start()


def _forget_if_idle() -> None:
    with _counting:
        if not _items:
            _loaded.cache_clear()


@functools.lru_cache(maxsize=1)
def _loaded(kept: Kept) -> Any:
    """The value that all items have in common; the last one stays, with all that it has computed about itself."""
    try:
        return load_value(Path(kept.folder), {file.name: file for file in kept.files})
    except (DamagedError, OSError) as error:
        raise ResourceError(
            f"the worker on {socket.gethostname()} can't read what it was given: {error}", hint=DISK
        ) from error
