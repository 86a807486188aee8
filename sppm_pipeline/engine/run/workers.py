"""Worker processes: what they must have in common with the process that hands out work, and items of a run's work."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import os
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from sppm_pipeline.engine.cache.identity import environment, installed_version, program_digest
from sppm_pipeline.engine.files import DISK
from sppm_pipeline.engine.plan.plugins import Plugins, import_file
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.outputs import staging_name
from sppm_pipeline.errors import ConfigError, ResourceError
from sppm_pipeline.nouns.storage import DamagedError, StoredFile, load_value


@dataclass(frozen=True)
class Driver:
    """The process that hands out the rows.

    `program` is the digest of its source, `versions` those of Python, libraries, plugins and the kind of processor.
    Each of the files `tokens`, one in the run directory and one in the cache, holds `token`.
    """

    host: str
    program: str
    versions: tuple[tuple[str, str], ...]
    tokens: tuple[str, ...]
    token: str
    same_processor: bool = False


@contextlib.contextmanager
def announced(path: Path, options: WorkerOptions, plugins: Plugins) -> Iterator[Driver]:
    """This process as a driver, with its tokens in the run directory and in the cache for as long as rows run."""
    distributions = tuple(sorted({plugin.distribution for plugin in plugins.plugins if plugin.distribution}))
    tokens = [path / staging_name()]
    if options.cache is not None:  # the same sweep again takes the place of what a killed one has left there
        tokens.append(options.cache.resolve() / f"driver-{hashlib.sha256(str(path).encode()).hexdigest()[:16]}")
    # tokens show that a worker sees the same folders, not others of the same name
    driver = Driver(
        host=socket.gethostname(),
        program=program_digest(),
        versions=tuple(_versions(distributions).items()),
        tokens=tuple(str(token) for token in tokens),
        token=secrets.token_hex(8),
        same_processor=options.same_processor,
    )
    try:
        for token in tokens:
            try:
                token.parent.mkdir(parents=True, exist_ok=True)
                token.write_text(driver.token, "ascii")
            except OSError as error:
                raise ResourceError(f"can't write into {str(token.parent)!r}: {error.strerror}") from error
        yield driver
    finally:
        for token in tokens:
            with contextlib.suppress(OSError):
                token.unlink()


def check_worker(driver: Driver) -> list[str]:
    """Check that this worker process gives the results that the driver's process would.

    Returns warnings, at the first call in a process only: another processor may compute other last digits.
    `ConfigError` lists what is another: the program, a library, a plugin, or where it must not be the processor;
    `ResourceError` if it does not see the driver's folders.
    """
    before = _looked_at.cache_info().misses
    warning = _looked_at(driver)
    return [warning] if warning and _looked_at.cache_info().misses > before else []


@functools.lru_cache(maxsize=1)
def _looked_at(driver: Driver) -> str:
    host = socket.gethostname()
    for token in map(Path, driver.tokens):
        try:
            seen = token.read_text("ascii")
        except OSError:
            seen = ""
        # a folder of that name may exist on the worker's machine, too
        if seen != driver.token:
            raise ResourceError(
                f"the worker on {host} does not share the folder {str(token.parent)!r} with {driver.host}",
                hint="choose a run directory with -o, and a cache with --cache, on a file system that all share",
            )
    wanted = dict(driver.versions)
    here = _versions(tuple(name.removeprefix(_PLUGIN) for name in wanted if name.startswith(_PLUGIN)))
    other = [
        f"{name} {here.get(name, 'not installed')} instead of {version}"
        for name, version in wanted.items()
        if here.get(name) != version and (driver.same_processor or name != "processor")
    ]
    if program_digest() != driver.program:
        other.append(f"sppm_pipeline with the digest {program_digest()[:12]} instead of {driver.program[:12]}")
    if other:
        raise ConfigError(
            f"the worker on {host} is not that of {driver.host}: {'; '.join(other)}",
            hint="start the workers in the same environment, with the same plugins",
        )
    if here["processor"] == wanted["processor"]:
        return ""
    return f"the processor of {host} is not that of {driver.host}: last digits may differ"


_PLUGIN = "plugin "
"""Prefix of the names of plugins among the versions."""


def _versions(distributions: tuple[str, ...]) -> dict[str, str]:
    """Versions that results depend on besides the program."""
    plugins = {_PLUGIN + name: installed_version(name) or "not installed" for name in distributions}
    return environment(plugins=("sppm-pipeline", *distributions)) | plugins


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
