"""Interruption of a run within two seconds, whatever it is doing; its records are put in order even if it hangs.

A stage may be deep inside of compiled code that does not see signals. So work goes on in a thread of its own while the
main thread waits for signals (`interruptibly`). When one comes, the next call of a stage to its context raises
`KeyboardInterrupt` (`check`); if that does not happen soon enough, `cancel_all` writes the records from outside, and
the process is ended.

A process that does several things at once, as a server does, may stop one of them and leave the others alone: what goes
on `within` a `Stop` ends when that is requested.
"""

from __future__ import annotations

import contextlib
import functools
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

from sppm_pipeline.engine.process.activity import leave
from sppm_pipeline.engine.process.tree import signal_below
from sppm_pipeline.errors import SppmError

PATIENCE = 0.6
"""Seconds that work is given to end by itself."""

POLL = 0.1
"""Seconds after which the main thread looks for signals that were handed to another thread, which do not wake it."""

BEGINNING = 0.2
"""Seconds that threads are given to begin before an exception is raised in the one that started them."""

STACK = 16 << 20
"""Bytes of stack; that of the main thread is smaller on some systems, and that of threads always is on macOS."""


class Cancelable(Protocol):
    """Something that has records on disk while it runs."""

    def cancel(self, error: SppmError | None) -> None:
        """Put the records in order, from another thread; `error` is why, if it was no interrupt."""


class Interrupted(KeyboardInterrupt):
    """A signal has ended the work; `number` is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


class Stop:
    """Asks one piece of work to end, whatever else goes on in this process."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def request(self) -> None:
        """Ask what goes on within this to end; for good."""
        self._event.set()

    @property
    def requested(self) -> bool:
        """True if it was asked to end."""
        return self._event.is_set()


_requested = threading.Event()
_scope: ContextVar[Stop | None] = ContextVar("sppm-stop", default=None)
"""Of each thread; work that is handed to other threads takes it along (`current_stop`)."""
_running: list[tuple[Cancelable, int]] = []
"""Runs, and the thread of each."""
_observers: list[Callable[[Path], None]] = []


def request() -> None:
    """Ask everything that runs to stop."""
    _requested.set()


@contextlib.contextmanager
def within(stop: Stop) -> Iterator[None]:
    """Work of this thread inside ends by `KeyboardInterrupt` if `stop` is requested."""
    token = _scope.set(stop)
    try:
        yield
    finally:
        _scope.reset(token)


def current_stop() -> Stop | None:
    """The scope that this thread works within, for threads that help it."""
    return _scope.get()


def check(stop: Stop | None = None) -> None:
    """Raise `KeyboardInterrupt` if everything was asked to stop, or `stop` was, or what this thread works within."""
    if requested(stop):
        raise KeyboardInterrupt


def requested(stop: Stop | None = None) -> bool:
    """True if everything was asked to stop, or `stop` was, or what this thread works within."""
    own = stop or _scope.get()
    return _requested.is_set() or (own is not None and own.requested)


def reset() -> None:
    """Forget that everything was asked to stop, once it has stopped."""
    _requested.clear()


def register(run: Cancelable, path: Path) -> None:
    """Remember a run that has to be canceled if it can't end by itself, and notify of the directory it writes to."""
    _running.append((run, threading.get_ident()))
    for notify in _observers:
        notify(path)


def unregister(run: Cancelable) -> None:
    """Forget a run that has ended."""
    _running[:] = [(other, thread) for other, thread in _running if other is not run]


def on_register(observer: Callable[[Path], None]) -> None:
    """Call a function with each run directory from now on."""
    _observers.append(observer)


def cancel_all(error: SppmError | None = None, offender: int | None = None) -> None:
    """End the child processes and cancel everything that runs, the last to begin first; no `error` means an interrupt.

    Only runs of the thread `offender` have failed by the error; those of others are interrupted.
    """
    # workers of a sweep end by SIGTERM, supervisors of native children then end what is below them
    signal_below(os.getpid(), signal.SIGTERM, recursive=False)
    while _running:
        with contextlib.suppress(Exception):
            run, thread = _running.pop()
            run.cancel(error if thread == offender else None)


def interruptibly(work: Callable[[], int], notify: Callable[[], None]) -> int:
    """Do `work` in a thread, and raise `Interrupted` if a signal came and it has ended in time.

    `KeyboardInterrupt` is raised in the work at its next step of Python. If it is inside of compiled code for longer
    than `PATIENCE`, its records are put in order from here, `notify` informs the user, and the process is ended.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    outcome: list[int | BaseException] = []
    signals: list[int] = []
    # a queue, as a signal may arrive while the main thread holds the lock inside of an event
    wake: queue.SimpleQueue[None] = queue.SimpleQueue()

    def target() -> None:
        try:
            outcome.append(work())
        except BaseException as error:
            outcome.append(error)
        finally:
            wake.put(None)

    def arrived(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        wake.put(None)

    before = threading.stack_size(STACK)
    thread = threading.Thread(target=target, name="sppm-work", daemon=True)
    with _handled(arrived):
        thread.start()
        threading.stack_size(before)
        while not (outcome or signals):
            with contextlib.suppress(queue.Empty):
                wake.get(timeout=POLL)
        if signals and not outcome:
            _end(thread, outcome, signals, notify)
        thread.join()
    if signals:
        raise Interrupted(signals[0])
    result = outcome[0]
    if isinstance(result, BaseException):
        raise result
    return result


@contextlib.contextmanager
def _handled(handler: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Handle the signals that end programs, but those that were turned off, as `nohup` and shells do."""
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {number: signal.getsignal(number) for number in numbers}
    kept = {number: old for number, old in before.items() if old not in (signal.SIG_IGN, None)}
    for number in kept:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in kept.items():
            signal.signal(number, old)


def _end(
    thread: threading.Thread, outcome: list[int | BaseException], signals: list[int], notify: Callable[[], None]
) -> None:
    """Ask for an end, wait for a moment, and enforce it; a second signal enforces it at once."""
    sys.unraisablehook = functools.partial(_ignore_interrupts, sys.unraisablehook)
    request()
    raise_in(thread.ident or 0, KeyboardInterrupt)
    deadline = time.monotonic() + PATIENCE
    while not outcome and len(signals) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    # also if the work has ended: workers that it started may still run
    cancel_all()
    if outcome:
        reset()
        return
    notify()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    leave(128 + signals[0])


def _ignore_interrupts(before: Callable[[Any], Any], unraisable: Any) -> None:
    """Say nothing of an interrupt that arrived where none can be raised, as in a callback of the linker of kernels.

    It is not lost: the next call of a stage to its context raises it again.
    """
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        before(unraisable)


def raise_in(thread: int, kind: type[BaseException] | None) -> None:
    """Raise an exception in another thread, at its next step of Python; None takes back what was not raised yet.

    Python looks for the first thread of that number (`threading.get_ident`), and a thread that is about to begin still
    has the number of its starter: it would die of the exception, and the right one go on. So this waits until none
    begins.
    """
    import ctypes

    deadline = time.monotonic() + BEGINNING
    while any(t.ident is None for t in threading.enumerate()) and time.monotonic() < deadline:
        time.sleep(0.001)
    with contextlib.suppress(AttributeError):  # not every Python has it
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), kind and ctypes.py_object(kind))
