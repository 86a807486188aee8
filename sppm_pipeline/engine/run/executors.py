"""Executors for the runs of a sweep; all speak `concurrent.futures.Executor`, so that a cluster's fits as well."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from typing import Any

from sppm_pipeline.engine.config.problems import did_you_mean
from sppm_pipeline.engine.plan.plugins import Plugins
from sppm_pipeline.errors import ConfigError, PluginError
from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.process.tree import die_with_parent


class SerialExecutor(Executor):
    """Runs each task at once, in the calling thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Run the task and return its finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _serial(workers: int) -> Executor:
    return SerialExecutor()


def _threads(workers: int) -> Executor:
    from concurrent.futures import ThreadPoolExecutor

    return ThreadPoolExecutor(workers, thread_name_prefix="sppm")


def _processes(workers: int) -> Executor:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    # spawned, not forked: a fork of a process with threads may hang, and only spawning works everywhere
    spawn = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=spawn, initializer=begin_worker, initargs=(os.getpid(),))


def begin_worker(parent: int) -> None:
    """Prepare a worker process: its parent alone decides when it ends, and it does not outlive it."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent(parent)
    threading.Thread(target=_leave_after_parent, daemon=True).start()


def _leave_after_parent() -> None:
    """Where the system does not end orphans, do it ourselves."""
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@hookimpl
def sppm_executors() -> Mapping[str, Callable[[int], Executor]]:
    """The built-in executors."""
    return {"serial": _serial, "threads": _threads, "processes": _processes}


def default_executor(workers: int) -> str:
    """The name of the executor that is used unless another one is asked for."""
    return "processes" if workers > 1 else "serial"


def make_executor(name: str | None, workers: int, plugins: Plugins) -> Executor:
    """The executor called `name`; without a name, processes if there is more than one worker.

    Raises
    ------
    ConfigError
        If there is no such executor.
    PluginError
        If a plugin's function does not return an executor.
    """
    there = {key: (make, plugin) for plugin in plugins.plugins for key, make in plugin.executors.items()}
    name = name or default_executor(workers)
    if name not in there:
        raise ConfigError(f"there is no executor {name!r}", hint=did_you_mean(name, there))
    make, plugin = there[name]
    try:
        executor = make(workers)
    except Exception as error:
        raise PluginError(f"{plugin}: the executor {name!r} raised {type(error).__name__}: {error}") from error
    if not isinstance(executor, Executor):
        raise PluginError(f"{plugin}: the executor {name!r} is no concurrent.futures.Executor")
    return executor
