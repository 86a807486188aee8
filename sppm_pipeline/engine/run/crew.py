"""The workers of a single run: stages hand them parts of their work by `Context.map`."""

from __future__ import annotations

import contextlib
import math
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.files import DISK, clear
from sppm_pipeline.engine.plan.estimate import PlanEstimate
from sppm_pipeline.engine.plan.plugins import Plugins
from sppm_pipeline.engine.process.interruption import check
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import LISTENING, WorkerOptions, make_executor, stop_workers
from sppm_pipeline.engine.run.outputs import staging_name
from sppm_pipeline.engine.run.workers import Driver, Kept, Task, announced, name_of, run_item
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, described
from sppm_pipeline.nouns.storage import save_value

AHEAD = 2
"""Items in work or waiting for each worker, so that none waits for the next: a heuristic; more takes memory only."""

MIN_SECONDS = 10.0
"""Seconds of one core that work must take by the table of rates to be worth processes of this machine. Each starts in
one to three seconds, of which it computes nothing, and the threads of this process would share the work, too."""

MIN_SAMPLES = 1e9
"""Samples that stand for these seconds where their cost is unknown: 3 s of the cheapest fields, minutes of others."""


@dataclass
class _Job:
    task: Task
    future: Future[tuple[Any, list[str]]] | None = None
    deaths: int = 0


class WorkerPool:
    """The workers of one run, started when a stage first asks for them.

    `path` is the run directory, which they share; `threads` are those of each; stages below `minimum` samples get no
    workers (`min_samples`). `warn` is called once with each warning of a worker.
    """

    def __init__(
        self,
        plugins: Plugins,
        path: Path,
        options: WorkerOptions,
        *,
        monitor: Monitor | None = None,
        minimum: float = 0.0,
    ) -> None:
        self.workers, self.threads = options.workers, options.threads_each
        self.warn: Callable[[str], None] = lambda message: None
        self._plugins = plugins
        self._path = path.resolve()
        self._options = options
        self._monitor = monitor or Monitor()
        self._minimum = minimum
        self._ending = contextlib.ExitStack()
        self._driver: Driver | None = None
        self._pool: Executor | None = None
        self._folder: Path | None = None
        self._kept: tuple[Any, Kept] | None = None
        self._shared: list[Path] = []
        self._folders = 0
        self._announced = self._declined = False
        self._said: set[str] = set()

    def takes(self, samples: float) -> bool:
        """True if workers are given work of so many samples; if not, the monitor reports it, once."""
        if samples >= self._minimum:
            return True
        if not self._declined:
            self._declined = True
            self._monitor.crew_left_out("its work is too little for processes of their own")
        return False

    def folder(self) -> Path:
        """A new folder that all workers see, gone after the run; `ResourceError` if it can't be made."""
        try:
            if self._folder is None:
                self._folder = self._path / staging_name()
                self._ending.callback(clear, self._folder)
            self._folders += 1
            made = self._folder / str(self._folders)
            made.mkdir(parents=True)
        except OSError as error:
            raise ResourceError(f"can't write into {str(self._path)!r}: {error.strerror}", hint=DISK) from error
        return made

    def map(self, function: Callable[[Any, Any], Any], items: Iterable[Any], common: Any) -> Iterator[Any]:
        """See `Context.map`; an item whose worker dies is handed out again, up to `retries` times, then `NativeCrash`.

        `NotStorable` if `common` can't be kept.
        """
        # tasks travel by the name of their function: no pickled code is run by a worker
        name = name_of(function)
        kept = self._keep(common) if common is not None else None
        self._open()
        assert self._driver is not None
        files = tuple(str(module.__file__) for module in self._plugins.single_files())
        waiting: deque[_Job] = deque()
        coming = iter(items)
        try:
            while True:
                # in order: results are delivered as they come in the sequence of the items
                while len(waiting) < AHEAD * self.workers and (item := next(coming, _END)) is not _END:
                    waiting.append(_Job(Task(name, kept, item, self._driver, os.getpid(), files)))
                    self._submit(waiting[-1])
                if not waiting:
                    return
                result = self._result(waiting)
                waiting.popleft()
                yield result
        except KeyboardInterrupt:
            from concurrent.futures import ProcessPoolExecutor

            stop_workers()
            if isinstance(self._pool, ProcessPoolExecutor):
                waiting.clear()  # a pool that has lost its processes stumbles over futures that were canceled
            raise
        finally:
            for job in waiting:
                if job.future is not None:
                    job.future.cancel()

    def forget(self) -> None:
        """Let go of what the calls of `map` had in common, here and on the disk; the workers do so when idle."""
        self._kept = None
        while self._shared:
            clear(self._shared.pop())

    def close(self) -> None:
        """End the workers, and remove what they shared."""
        try:
            self._stop()
        finally:
            self._ending.close()
            self._driver = self._kept = self._folder = None

    # --- workers ---

    def _open(self) -> None:
        if self._driver is None:
            driver = announced(self._path, self._options, self._plugins)
            self._driver = self._ending.enter_context(driver)
        if self._pool is None:
            self._pool = make_executor(self._options.name, self.workers, self._plugins)
            if not self._announced:
                self._announced = True
                self._monitor.crew_started(getattr(self._pool, "about", f"{self.workers} {self._options.name}"))

    def _stop(self) -> None:
        if self._pool is not None:
            pool, self._pool = self._pool, None
            pool.shutdown(wait=True)

    def _submit(self, job: _Job) -> None:
        """Hand an item out; that the executor is broken is found when its result is asked for."""
        self._open()
        assert self._pool is not None
        try:
            job.future = self._pool.submit(run_item, job.task)
        except BrokenExecutor as error:
            job.future = Future()
            job.future.set_exception(error)

    def _result(self, waiting: deque[_Job]) -> Any:
        """The result of the first item."""
        while True:
            check()
            job = waiting[0]
            assert job.future is not None
            try:
                error = job.future.exception(timeout=LISTENING)
            except TimeoutError:
                continue
            except CancelledError as canceled:
                error = canceled
            if error is None:
                result, warnings = job.future.result()
                for warning in warnings:
                    if warning not in self._said:
                        self._said.add(warning)
                        self.warn(warning)
                return result
            if isinstance(error, BrokenExecutor):
                self._begin_again(waiting, error)
            elif isinstance(error, NativeCrash):
                self._count([job], error)
                self._submit(job)
            elif isinstance(error, (CancelledError, ConnectionError)):
                text = f"the executor {self._options.name!r} lost work: {described(error)}"
                raise PluginError(text, hint="the same command goes on after the last stage that has ended") from error
            else:
                raise error

    def _begin_again(self, waiting: deque[_Job], error: BrokenExecutor) -> None:
        """New workers, and all that the old ones had not finished."""
        self._stop()
        # results that had arrived are kept
        futures = [(job, job.future) for job in waiting]
        left = [job for job, one in futures if not (one and one.done() and not one.cancelled() and not one.exception())]
        self._count(left, error)
        for job in left:
            self._submit(job)

    def _count(self, jobs: Sequence[_Job], error: BaseException) -> None:
        """Note that a worker has died while these were in its hands."""
        for job in jobs:
            job.deaths += 1
        if (deaths := max(job.deaths for job in jobs)) > self._options.retries:
            why = f": {error}" if isinstance(error, NativeCrash) else ""
            times = "once" if deaths == 1 else f"{deaths} times"
            raise NativeCrash(
                f"a worker process died, {times} of the same work{why}",
                hint="a native library crashed, or memory ran out; try fewer workers with -j, or --executor serial",
            ) from error
        self._monitor.warning(None, "a worker process died; its work is handed out again")

    # --- what they share ---

    def _keep(self, common: Any) -> Kept:
        """Write a value where all workers load it; once, however often it is given in turn."""
        # by identity: arrays of gigabytes are not compared
        if self._kept is None or self._kept[0] is not common:
            folder = self.folder()
            self._shared.append(folder)
            try:
                files = save_value(common, folder)
            except OSError as error:
                raise ResourceError(f"can't write into {str(folder)!r}: {error.strerror}", hint=DISK) from error
            self._kept = (common, Kept(str(folder), tuple(files)))
        return self._kept[1]


def min_samples(executor: str | None, estimate: PlanEstimate) -> float:
    """Samples of a stage from which on workers are used, 0 to infinity: a function of the configuration alone.

    An executor that was named is used for all. Processes of this machine, if no executor was named, are used if the
    stages that hand out work take `MIN_SECONDS` of one core together, by the table of rates and not by what the machine
    has learned; if that is unknown, for stages with `MIN_SAMPLES`.
    """
    if executor is not None:
        return 0.0
    if (seconds := estimate.handed_out) is None:
        return MIN_SAMPLES
    return 0.0 if seconds >= MIN_SECONDS else math.inf


_END: Any = object()
