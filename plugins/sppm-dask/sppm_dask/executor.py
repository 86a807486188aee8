"""An executor on Dask's scheduler: a local cluster, a running one, or one whose workers are jobs of a queue."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import logging
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterable
from concurrent.futures import BrokenExecutor, Executor, Future, InvalidStateError
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import dask
from distributed import Client, LocalCluster
from distributed.scheduler import KilledWorker

from sppm_pipeline import ConfigError, stop_requested
from sppm_pipeline.errors import NativeCrash, ResourceError

QUEUES = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "lsf": "LSFCluster",
    "sge": "SGECluster",
    "oar": "OARCluster",
    "moab": "MoabCluster",
    "htcondor": "HTCondorCluster",
}
"""Classes of dask_jobqueue, by what stands after ``dask:``."""

CONNECTING = "20s"
"""Time for a scheduler to answer, a heuristic: one that runs answers within a second."""

AT_ONCE = 0.2
"""Seconds that an interrupted sweep waits for its cluster: below `interruption.PATIENCE`."""

WITHOUT_WORKERS = 60.0
"""Seconds after which a cluster that was started here, has work and no worker is given up, and others are reported.

A heuristic: starting a worker again takes a few seconds, twenty on a busy machine. Dask starts a worker again that has
died, but not one that dies before its nanny has seen it run.
"""

SETTLED = 5.0
"""Seconds that a task may stay without an outcome after the scheduler went, a heuristic; only the message waits.

Dask cancels the tasks that run, but one whose result is on its way may be heard of no more.
"""

GONE = "the Dask scheduler is gone"

LOCAL = {
    # a row that kills its worker is found soon: the engine repeats those that were hit, each alone
    "distributed.scheduler.allowed-failures": 1,
    # rows are heavy: none waits at a worker that may die of another one
    "distributed.scheduler.worker-saturation": 1.0,
}
"""Settings of the clusters that are started here."""


class DaskExecutor(Executor):
    """Hands tasks to the workers of a Dask cluster.

    `where` is empty for `workers` processes of this machine; the address of a scheduler (``tcp://head:8786``), or its
    scheduler file, whose cluster has the workers it has; or the name of a queue (`QUEUES`), which is set up in Dask's
    own configuration, with at most `workers` jobs at a time. `ConfigError` if it is none of these, `ResourceError` if
    the scheduler does not answer or the queue refuses the workers. `notify`, set by the engine, is called with a
    message while tasks wait.
    """

    def __init__(self, workers: int, where: str = "") -> None:
        # what it and its event loop log as errors are tracebacks, of what the rows' own errors say
        for name in ("distributed", "distributed.client", "tornado.application"):  # each has a level of its own
            logging.getLogger(name).setLevel(logging.CRITICAL)
        self._ending = contextlib.ExitStack()
        self._closed, self._shut = False, threading.Event()
        self._open: set[Future[Any]] = set()
        self._broken = ""
        self.notify: Callable[[str], None] = lambda message: None
        with contextlib.ExitStack() as ending:
            try:
                self._client = ending.enter_context(_client(workers, where, ending))
            except (OSError, TimeoutError, ValueError, RuntimeError) as error:
                raise ResourceError(
                    f"no Dask scheduler at {where or 'this machine'}: {error}",
                    hint="start one with `dask scheduler`, or look whether its address can be reached from here",
                ) from error
            self._tasks = self._client.get_executor(pure=False)  # equal tasks are several tasks
            self._ending = ending.pop_all()
        self.about = f"Dask at {self._client.scheduler.address}, {_counted(workers, where, self._client)}"
        self._local = isinstance(self._client.cluster, LocalCluster)
        threading.Thread(target=self._watch, name="sppm-dask-watch", daemon=True).start()
        if link := self._client.dashboard_link if importlib.util.find_spec("bokeh") else "":
            self.about += f", dashboard at {link}"

    @property
    def _alive(self) -> bool:
        return self._client.status in ("running", "connecting")

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Hand a task to the cluster; if its workers died of it, its exception is a `NativeCrash`.

        `BrokenExecutor` if the scheduler is gone, or all workers of a cluster that was started here.
        """
        if self._closed:
            raise RuntimeError("the executor was shut down")
        if not self._alive:
            raise BrokenExecutor(GONE)
        if self._broken:
            raise BrokenExecutor(self._broken)
        # the arguments are the task's own, and none of them Dask's
        inner = self._tasks.submit(functools.partial(fn, *args, **kwargs))
        outer: Future[Any] = Future()
        self._open.add(outer)
        outer.add_done_callback(self._open.discard)
        if self._broken:  # meanwhile, and perhaps without this one
            outer.cancel()
            inner.cancel()
            raise BrokenExecutor(self._broken)
        # cut when there is an outcome: the workers keep a result as long as this process refers to its future
        link = [inner]
        outer.add_done_callback(functools.partial(_cancel, link))
        inner.add_done_callback(functools.partial(_pass_on, outer, link))
        return outer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End; a cluster that was started here ends as well. May be called twice.

        When the sweep is interrupted there is no time: processes of this machine end with this one, jobs of a queue are
        canceled in the background while the records are put in order.
        """
        if self._closed:
            return
        self._closed = True
        self._shut.set()
        if stop_requested():
            closing = threading.Thread(target=self._ending.close, daemon=True)
            if self._local:
                self._client.cluster.shutdown_on_close = False
                for process in multiprocessing.active_children():
                    process.kill()
                    process.join(AT_ONCE)
            closing.start()
            closing.join(AT_ONCE)
            return
        try:
            # cancels what has not ended, unless it waits for it
            if self._alive:
                self._tasks.shutdown(wait=wait and not cancel_futures and not self._broken)
        finally:
            self._ending.close()

    def _watch(self) -> None:
        """Give up tasks that Dask will say nothing of any more."""
        comm, since, reported = self._client.scheduler_comm, time.monotonic(), False
        lost: dict[Future[Any], float] = {}
        while not self._shut.wait(min(1.0, SETTLED / 4, WITHOUT_WORKERS / 4)):
            now = time.monotonic()
            if self._client.status != "running" or self._client.scheduler_comm is not comm:
                comm = self._client.scheduler_comm
                lost = {future: lost.get(future, now) for future in list(self._open)}
            _give_up((f for f, when in lost.items() if now - when > SETTLED), ConnectionError(GONE))
            if not self._open or self._count_workers():
                since, reported = now, False
            elif self._local and now - since > WITHOUT_WORKERS:
                self._broken = "all workers of the local Dask cluster died, and none could be started again"
                _give_up(list(self._open), BrokenExecutor(self._broken))
                return
            elif not reported and now - since > WITHOUT_WORKERS:
                # others may start workers at any time, as a queue does, so the tasks wait for them
                reported = True
                self.notify(
                    f"the Dask cluster at {self._client.scheduler.address} has had no workers for "
                    f"{WITHOUT_WORKERS:.0f} s; the runs wait for one"
                )

    def _count_workers(self) -> int:
        """Number of workers; 1 where it is unknown, as while the scheduler is gone."""
        if self._local:
            return len(self._client.cluster.scheduler.workers)
        try:
            return len(self._client.scheduler_info(n_workers=-1)["workers"])
        except Exception:  # whatever a client raises whose connection has just broken
            return 1


def _give_up(futures: Iterable[Future[Any]], error: Exception) -> None:
    for future in futures:
        with contextlib.suppress(InvalidStateError):
            future.set_exception(error)


def _client(workers: int, where: str, ending: contextlib.ExitStack) -> Any:
    """A client of the cluster that `where` names; one that is started ends with `ending`."""
    if not where:
        # its files are removed with it
        scratch = ending.enter_context(TemporaryDirectory(prefix="sppm-dask-", ignore_cleanup_errors=True))
        ending.enter_context(dask.config.set(LOCAL))
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=0,  # stages say what they need; Dask would end a row that needs more than its share
            dashboard_address="127.0.0.1:0",  # any free port
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
        )
        return Client(ending.enter_context(cluster), set_as_default=False)
    if "://" in where:
        return Client(where, timeout=CONNECTING, set_as_default=False)
    if (file := Path(where).expanduser()).is_file():
        return Client(scheduler_file=str(file), timeout=CONNECTING, set_as_default=False)
    if where not in QUEUES:
        raise ConfigError(
            f"dask:{where} is no address, no scheduler file and no queue",
            hint=f"dask:tcp://HOST:8786, dask:FILE.json, or one of {', '.join(f'dask:{name}' for name in QUEUES)}",
        )
    try:
        queues = importlib.import_module("dask_jobqueue")
    except ImportError as error:
        raise ConfigError(f"dask:{where} needs dask-jobqueue", hint="pip install dask-jobqueue") from error
    cluster = ending.enter_context(getattr(queues, QUEUES[where])())  # partition, cores and time: ~/.config/dask
    cluster.adapt(minimum_jobs=1, maximum_jobs=workers)
    return Client(cluster, set_as_default=False)


def _counted(workers: int, where: str, client: Any) -> str:
    """Number of workers, in words."""
    if where in QUEUES:
        return f"at most {workers} jobs of {where}"
    there = len(client.scheduler_info(n_workers=-1)["workers"])
    return f"{there} worker{'' if there == 1 else 's'}"


def _cancel(link: list[Future[Any]], outer: Future[Any]) -> None:
    if outer.cancelled():
        for inner in link:
            inner.cancel()


def _pass_on(outer: Future[Any], link: list[Future[Any]], inner: Future[Any]) -> None:
    """Give the outcome of Dask's future to the engine's, which may be canceled meanwhile."""
    link.clear()
    with contextlib.suppress(InvalidStateError):
        if inner.cancelled():  # not by this process
            outer.set_exception(ConnectionError(GONE))
        elif (error := inner.exception()) is None:
            outer.set_result(inner.result())
        elif isinstance(error, KilledWorker):
            outer.set_exception(_crash(error))
        else:
            outer.set_exception(error)


def _crash(error: KilledWorker) -> NativeCrash:
    return NativeCrash(
        f"the worker died {error.allowed_failures + 1} times, last at {error.last_worker.address}",
        hint="a native library crashed, memory ran out, or the queue ended the job; the worker's log says more",
    )
