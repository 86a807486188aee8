"""Compiling ahead: the kernels that a plan will call and that no earlier run has left on the disk, in child processes.

Numba compiles a function when it is first called, one at a time in a process. Which stage calls which kernel with what
types is known from a list that comes with the program (`engine.plan.kernels`). So
child processes compile while the first stages run, and each stage waits only for the kernels that are listed for it.
What is not on the list is compiled when it is called. Nothing depends on it but time: a child that dies, a folder that
can't be written or an outdated list leave the work to the run itself.
"""

from __future__ import annotations

import contextlib
import functools
import os
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.plan.kernels import (
    MIN_SECONDS_AHEAD,
    SWITCH,
    Kernel,
    kernels_of,
    listed_kernels,
    missing,
    stages_of,
)
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.process.interruption import check
from sppm_pipeline.engine.run.events import Monitor

if TYPE_CHECKING:
    from concurrent.futures import Future

MAX_PROCESSES = 8
"""Child processes that compile: each takes 200 MB, and from about eight on the longest kernel sets the time."""


def in_order(kernels: Iterable[Kernel], stages: Sequence[str]) -> list[Kernel]:
    """Kernels in the order of the stages that call them first; of a stage, those that take longest."""
    return sorted(
        kernels,
        key=lambda k: (min((stages.index(s) for s in k.stages if s in stages), default=len(stages)), -k.seconds),
    )


class Waiting(Monitor):
    """A monitor that lets a stage begin when the kernels listed for it are compiled."""

    ahead: CompileAhead | None = None

    def stage_started(self, stage: str, number: int, total: int) -> None:
        if self.ahead is not None:
            self.ahead.wait(stage, self.compiling)

    def compiling(self, done: int, total: int, share: float) -> None:
        """So many of all kernels are compiled, with this share of the time that all take."""

    def not_compiled(self, place: str, why: str) -> None:
        """A kernel could not be compiled ahead, which is left to its first call. Calls may come from any thread."""


class CompileAhead:
    """Child processes that compile kernels; `ids` are stage names by id, `failed` is called with each kernel that could
    not be compiled, and why.
    """

    def __init__(
        self,
        kernels: Sequence[Kernel],
        processes: int,
        ids: dict[str, str],
        failed: Callable[[str, str], None] = lambda place, why: None,
    ) -> None:
        import multiprocessing
        from concurrent.futures import ProcessPoolExecutor

        from sppm_pipeline.engine.run.executors import begin_worker

        self._ids = ids
        self._failed = failed
        self._ended: set[Future[None]] = set()  # and reported, which futures that are done need not be yet
        self._changed = threading.Condition()
        self._pool = ProcessPoolExecutor(
            min(processes, len(kernels), MAX_PROCESSES),
            # not forked: a fork of a process with threads may hang
            mp_context=multiprocessing.get_context("spawn"),
            initializer=begin_worker,
            initargs=(os.getpid(),),
        )
        self._futures: list[tuple[Kernel, Future[None]]] = []
        with contextlib.suppress(OSError, RuntimeError):  # no more processes, or they die at once
            for kernel in in_order(kernels, list(ids.values())):
                future = self._pool.submit(_compile, kernel.place, kernel.signatures)
                future.add_done_callback(functools.partial(self._report, kernel))
                self._futures.append((kernel, future))

    def _report(self, kernel: Kernel, future: Future[None]) -> None:
        if not future.cancelled() and (error := future.exception()) is not None:
            self._failed(kernel.place, _why(error))
        with self._changed:
            self._ended.add(future)
            self._changed.notify_all()

    def wait(self, stage: str | None, notify: Callable[[int, int, float], None]) -> None:
        """Wait for the kernels of a stage, by its id, or of all stages; `notify` is called at each change with the
        number of kernels that are done, of all kernels, and their share of the time.
        """
        name = None if stage is None else self._ids.get(stage, stage)
        needed = [future for kernel, future in self._futures if name is None or name in kernel.stages]
        total = sum(kernel.seconds for kernel, _ in self._futures) or 1.0
        reported = -1
        while not self._ended.issuperset(needed):
            check()
            done = len(self._ended)
            if done != reported:
                # some take twenty times as long as others, so that their number says little of the time
                share = sum(kernel.seconds for kernel, future in self._futures if future in self._ended) / total
                notify(done, len(self._futures), share)
                reported = done
            with self._changed:
                self._changed.wait(0.1)

    def close(self) -> None:
        """End the processes; what they have compiled stays."""
        self._failed = lambda place, why: None  # what is ended from here has not failed
        processes = list((self._pool._processes or {}).values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()


def _why(error: BaseException) -> str:
    """In one line why a child has not compiled."""
    from concurrent.futures import BrokenExecutor

    if isinstance(error, BrokenExecutor):
        return "a compiling process died"
    return f"{type(error).__name__}: {(str(error).strip().splitlines() or [''])[0]}"


def _compile(place: str, signatures: list[Any]) -> None:
    """In a child process."""
    import gc

    from sppm_pipeline.services.jit.compiling import compile_kernel

    gc.disable()  # a twelfth of the time; the compiler keeps most of what it makes
    compile_kernel(place, signatures)


@contextlib.contextmanager
def compiling_ahead(plan: Plan, monitor: Waiting, processes: int) -> Iterator[CompileAhead | None]:
    """Compile what a plan needs while it runs; stages wait for their kernels by the monitor."""
    wanted = kernels_of(stages_of(plan), listed_kernels())
    if processes < 2 or os.environ.get(SWITCH, "").lower() == "off":
        wanted = []
    needed = missing(wanted)
    ahead = None
    ids = {step.id: step.stage.name for step in plan.steps}
    if sum(k.seconds for k in needed) >= MIN_SECONDS_AHEAD:
        with contextlib.suppress(OSError, ImportError, NotImplementedError):  # no semaphores in this sandbox
            ahead = CompileAhead(needed, processes, ids, monitor.not_compiled)
    monitor.ahead = ahead
    try:
        yield ahead
    finally:
        monitor.ahead = None
        if ahead is not None:
            ahead.close()
