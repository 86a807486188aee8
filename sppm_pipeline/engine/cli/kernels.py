"""Compiling first: the kernels that a plan will call and that are not on the disk, in child processes.

Numba compiles a function when it is first called, one at a time in a process. Which stage calls which kernel with what
types is known from a list that comes with the program (`engine.plan.kernels`), so child processes share them out before
the first stage begins. What is not on the list is compiled when it is called. Nothing depends on it but time: a child
that dies, a folder that can't be written or an outdated list leave the work to the run itself.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from typing import Any

from sppm_pipeline.engine.cli.progress import ProgressLines
from sppm_pipeline.engine.plan.kernels import MIN_SECONDS_AHEAD, SWITCH, Kernel, missing_of
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.process.interruption import check

MAX_PROCESSES = 8
"""Child processes that compile: each takes 200 MB, and from about eight on the longest kernel sets the time."""


def compile_first(plan: Plan, progress: ProgressLines, processes: int) -> None:
    """Compile what a plan needs, if it takes long enough for child processes to be worth starting."""
    off = processes < 2 or os.environ.get(SWITCH, "").lower() == "off"
    kernels = [] if off else missing_of(plan)
    if sum(kernel.seconds for kernel in kernels) >= MIN_SECONDS_AHEAD:
        compile_apart(kernels, progress, processes)


def compile_apart(kernels: Sequence[Kernel], progress: ProgressLines, processes: int) -> None:
    """Compile kernels in child processes, those that take longest first."""
    import multiprocessing
    from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait

    from sppm_pipeline.engine.run.executors import begin_worker

    with contextlib.ExitStack() as stack:
        # no semaphores in this sandbox, no more processes, or they die at once
        stack.enter_context(contextlib.suppress(OSError, ImportError, NotImplementedError, RuntimeError))
        pool = ProcessPoolExecutor(
            min(processes, len(kernels), MAX_PROCESSES),
            # not forked: a fork of a process with threads may hang
            mp_context=multiprocessing.get_context("spawn"),
            initializer=begin_worker,
            initargs=(os.getpid(),),
        )
        stack.callback(_end, pool)
        longest_first = sorted(kernels, key=lambda kernel: -kernel.seconds)
        futures = {pool.submit(_compile, kernel.place, kernel.signatures): kernel for kernel in longest_first}
        total = sum(kernel.seconds for kernel in kernels) or 1.0
        left, done = set(futures), 0.0
        progress.compiling(0, len(futures), 0.0)
        while left:
            check()
            ended, left = wait(left, 0.1, FIRST_COMPLETED)
            for future in ended:
                if error := future.exception():
                    progress.not_compiled(futures[future].place, _why(error))
                # some take twenty times as long as others, so that their number says little of the time
                done += futures[future].seconds
            if ended:
                progress.compiling(len(futures) - len(left), len(futures), done / total)


def _end(pool: Any) -> None:
    """End the processes; what they have compiled stays."""
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
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
