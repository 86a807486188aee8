"""Signals: work goes on in a thread of its own, so that it can be ended within two seconds whatever it is doing."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

PATIENCE = 0.6
"""Seconds that work is given to end by itself."""

LISTENING = 0.1
"""Seconds after which the main thread looks for signals that were handed to another thread, which do not wake it."""

STACK = 16 << 20
"""Bytes of stack; that of the main thread is smaller on some systems, and that of threads always is on macOS."""


class Interrupted(KeyboardInterrupt):
    """A signal has ended the work; `number` is the signal's."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


def interruptibly(work: Callable[[], int], say: Callable[[], None]) -> int:
    """Do `work` in a thread, and end it when a signal comes.

    The work is asked to stop: `KeyboardInterrupt` is raised in it at its next step of Python. If it is inside of
    compiled code for longer than `PATIENCE`, its traces are put in order from here, and the process is left.

    Parameters
    ----------
    work : function
    say : function
        Tells the user, before the process is left.

    Raises
    ------
    Interrupted
        If a signal came and the work has ended in time.
    """
    if threading.current_thread() is not threading.main_thread():
        return work()
    outcome: list[int | BaseException] = []
    signals: list[int] = []
    wake = threading.Event()

    def target() -> None:
        try:
            outcome.append(work())
        except BaseException as error:
            outcome.append(error)
        finally:
            wake.set()

    def arrived(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        wake.set()

    before = threading.stack_size(STACK)
    thread = threading.Thread(target=target, name="sppm-work", daemon=True)
    with _handled(arrived):
        thread.start()
        threading.stack_size(before)
        while not wake.wait(LISTENING):
            pass
        if signals and not outcome:
            _end(thread, outcome, signals, say)
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
    thread: threading.Thread, outcome: list[int | BaseException], signals: list[int], say: Callable[[], None]
) -> None:
    """Ask for an end, wait for a moment, and enforce it; a second signal enforces it at once."""
    # nothing has to be ended if the engine was not even loaded
    interruption = sys.modules.get("sppm_pipeline.process.interruption")
    if interruption is not None:
        interruption.request()
    _raise_in(thread)
    deadline = time.monotonic() + PATIENCE
    while not outcome and len(signals) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    if interruption is not None:
        interruption.abandon_all()
    if outcome:
        if interruption is not None:
            interruption.reset()
        return
    say()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    os._exit(128 + signals[0])


def _raise_in(thread: threading.Thread) -> None:
    """Raise `KeyboardInterrupt` in another thread, at its next step of Python."""
    import ctypes

    with contextlib.suppress(AttributeError):  # not every Python has it
        ctypes.pythonapi.PyThreadState_SetAsyncExc(
            ctypes.c_ulong(thread.ident or 0), ctypes.py_object(KeyboardInterrupt)
        )
