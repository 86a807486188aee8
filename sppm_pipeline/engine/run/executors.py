"""Executors for the runs of a sweep, and their service; all are `concurrent.futures.Executor`, so a cluster's fits."""

from __future__ import annotations

import inspect
import os
import queue
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.plan.plugins import Plugin, Plugins
from sppm_pipeline.engine.process.interruption import check
from sppm_pipeline.engine.process.resident import share_one_heap
from sppm_pipeline.engine.process.tree import die_with_parent
from sppm_pipeline.errors import ConfigError, PluginError, SppmError, described, did_you_mean
from sppm_pipeline.hookspecs import hookimpl


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
    # the parent ends workers by SIGTERM, which must work even inside of compiled code
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    die_with_parent(parent)
    # many arenas of malloc would hold memory that each thread has freed
    share_one_heap()
    threading.Thread(target=_leave_after_parent, daemon=True).start()


def _leave_after_parent() -> None:
    """End this process after its parent, for systems that do not end orphans."""
    import multiprocessing
    from multiprocessing.connection import wait

    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


@hookimpl
def sppm_executors() -> Mapping[str, Callable[[int], Executor]]:
    """The built-in executors."""
    return {"serial": lambda workers: SerialExecutor(), "threads": _threads, "processes": _processes}


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """What is asked of the workers of a sweep or of a single run; `threads` are those of all together."""

    workers: int = 1
    executor: str | None = None  # processes if there is more than one worker
    threads: int = 1
    cache: Path | None = None
    retries: int = 2  # runs again of work whose worker died: it may have died because of work beside it
    same_processor: bool = False  # whether workers on another kind of processor are refused

    @property
    def name(self) -> str:
        """The executor, with the place where its workers are."""
        return self.executor or default_executor(self.workers)

    @property
    def apart(self) -> bool:
        """True if they are no part of this process, whose stages use its threads as they are."""
        return self.name.partition(":")[0] not in ("serial", "threads")

    @property
    def threads_each(self) -> int:
        """Threads of a worker."""
        return max(1, self.threads // self.workers)


def default_executor(workers: int) -> str:
    """The name of the executor that is used unless another one is asked for."""
    return "processes" if workers > 1 else "serial"


def require_executor(name: str | None, workers: int, plugins: Plugins) -> tuple[str, str, Callable[..., Any], Plugin]:
    """Name, place, function and plugin of the executor `name`, or `ConfigError`; see `make_executor`."""
    there = {key: (make, plugin) for plugin in plugins.plugins for key, make in plugin.executors.items()}
    name, colon, where = (name or default_executor(workers)).partition(":")
    if name not in there:
        raise ConfigError(f"there is no executor {name!r}", hint=did_you_mean(name, there))
    make, plugin = there[name]
    if colon and not _takes_where(make):
        raise ConfigError(f"the executor {name!r} takes no place, got {where!r} after the colon")
    return name, where, make, plugin


def make_executor(name: str | None, workers: int, plugins: Plugins) -> Executor:
    """The executor ``NAME`` or ``NAME:WHERE``; without a name, processes if there is more than one worker.

    `ConfigError` if there is no such executor, or it is in one place only; `PluginError` if a plugin's function does
    not return an executor.
    """
    name, where, make, plugin = require_executor(name, workers, plugins)
    try:
        executor = make(workers, where) if _takes_where(make) else make(workers)
    except SppmError:
        raise
    except Exception as error:
        raise PluginError(f"{plugin}: the executor {name!r} raised {described(error)}") from error
    if not isinstance(executor, Executor):
        raise PluginError(f"{plugin}: the executor {name!r} is no concurrent.futures.Executor")
    return executor


def _takes_where(make: Callable[..., Any]) -> bool:
    """True if a function has a second parameter `where`."""
    try:
        parameters = list(inspect.signature(make).parameters)
    except ValueError:  # some compiled functions have no signature
        return False
    return parameters[1:2] == ["where"]


LISTENING = 0.25
"""Seconds between two looks at whether the sweep was asked to stop."""


def serve(
    pool: Executor,
    function: Callable[[Mapping[str, Any]], dict[str, Any]],
    tasks: Mapping[int, Mapping[str, Any]],
    ended: Callable[[int, dict[str, Any]], None],
    failed: Callable[[int, BaseException], None],
    *,
    most: int,
) -> tuple[BaseException | None, list[int]]:
    """Hand numbered tasks to an executor until all have ended or it has broken down, and shut it down.

    Only `submit` and `shutdown` of the executor are used. `ended(number, result)` and `failed(number, error)` are
    called in this thread, and at most `most` tasks are held at a time. Returned are what the executor raised when it
    broke down, and the exit codes of worker processes, negative for a signal; those of other machines are not known.
    """
    # their exit codes say how they ended, which futures do not
    before, workers = set(_children()), []
    futures: dict[int, Future[dict[str, Any]]] = {}
    # tasks say when they are done: to ask all of them after each costs the square of their number
    done: queue.SimpleQueue[int] = queue.SimpleQueue()
    broken: BaseException | None = None

    def hear(seconds: float) -> bool:
        """Take in a task that is done; False if none is within that time."""
        nonlocal broken
        try:
            number = done.get(timeout=seconds) if seconds else done.get_nowait()
        except queue.Empty:
            return False
        future = futures.pop(number)
        try:
            error = future.exception()
        except CancelledError as canceled:
            error = canceled
        if error is None:
            ended(number, future.result())
        elif isinstance(error, BrokenExecutor):
            broken = error
        else:
            failed(number, error)
        return True

    try:
        for number, task in tasks.items():
            check()
            # a bounded queue: canceling is instant, and memory does not grow with the number of rows
            while len(futures) >= most and broken is None:
                check()
                hear(LISTENING)
            try:
                if broken is not None:
                    break
                futures[number] = pool.submit(function, task)
            except BrokenExecutor as error:
                broken = error
                break
            # the callback runs in a thread of the executor, so it only puts a number into a queue
            futures[number].add_done_callback(lambda future, number=number: done.put(number))  # type: ignore[misc]
            while hear(0):  # of an executor that runs tasks at once, before the next one
                pass
        workers = [process for process in _children() if process not in before]
        while futures:
            check()
            hear(LISTENING)  # not for ever, so that a request to stop is seen
    except BaseException:
        stop_workers()
        raise
    finally:
        for future in list(futures.values()):  # `shutdown` of a cluster's executor may not know how to
            future.cancel()
        pool.shutdown(wait=True)
    return broken, [process.exitcode for process in workers if process.exitcode is not None]


def _children() -> list[Any]:
    return sys.modules["multiprocessing"].active_children() if "multiprocessing" in sys.modules else []


def stop_workers() -> None:
    """End the worker processes, so that an interrupted one does not go on in the background.

    Runs in threads do not hear of the interruption; the native code that they wait for is ended for them.
    """
    for process in _children():
        process.terminate()
    if "sppm_pipeline.engine.process.native" in sys.modules:
        sys.modules["sppm_pipeline.engine.process.native"].stop_all()
