"""How a run is asked to stop, and what has to be done if it can't stop by itself in time.

A stage may be deep inside of compiled code that hears of nothing. So runs go on in a thread of their own while the
main thread waits for signals. When one comes, `request` makes the next call of a stage to its context raise
`KeyboardInterrupt`; if that does not happen soon enough, `abandon_all` writes the records from outside, and the
process is left as it is.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from sppm_pipeline.errors import SppmError


class Abandonable(Protocol):
    """Something that leaves traces on disk while it runs."""

    def cancel(self, error: SppmError | None) -> None:
        """Put the traces in order, from another thread; `error` is why, if it was no interrupt."""


_PR_SET_PDEATHSIG = 1

_requested = threading.Event()
_running: list[tuple[Abandonable, int]] = []
"""What runs, and in which thread."""
_listeners: list[Callable[[Path], None]] = []


def request() -> None:
    """Ask everything that runs to stop."""
    _requested.set()


def check() -> None:
    """Raise `KeyboardInterrupt` if everything was asked to stop."""
    if _requested.is_set():
        raise KeyboardInterrupt


def requested() -> bool:
    """Whether everything was asked to stop."""
    return _requested.is_set()


def reset() -> None:
    """Forget that everything was asked to stop, once it has stopped."""
    _requested.clear()


def running(what: Abandonable, path: Path) -> None:
    """Remember something that has to be put in order if it can't end by itself, and the directory it writes to."""
    _running.append((what, threading.get_ident()))
    for tell in _listeners:
        tell(path)


def tell_of_runs(listener: Callable[[Path], None]) -> None:
    """Let somebody know of each run directory from now on."""
    _listeners.append(listener)


def stopped_running(what: Abandonable) -> None:
    """Forget it."""
    _running[:] = [(other, thread) for other, thread in _running if other is not what]


def abandon_all(error: SppmError | None = None, culprit: int | None = None) -> None:
    """Put everything that runs in order; the last to begin comes first.

    Parameters
    ----------
    error : SppmError, optional
        Why, if it was no interrupt.
    culprit : int, optional
        The thread whose runs have failed by it; those of others are interrupted.
    """
    end_children()
    while _running:
        with contextlib.suppress(Exception):
            what, thread = _running.pop()
            what.cancel(error if thread == culprit else None)


def end_children() -> None:
    """End the processes that this one has started, such as the workers of a sweep."""
    pids: set[int] = set()
    if "multiprocessing" in sys.modules:
        children: list[Any] = sys.modules["multiprocessing"].active_children()
        pids |= {child.pid for child in children if child.pid is not None}
    with contextlib.suppress(OSError, ValueError):  # Linux tells of the others as well
        for task in Path("/proc/self/task").iterdir():
            pids |= {int(word) for word in (task / "children").read_text().split()}
    for pid in pids:
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGTERM)


def die_with_parent(parent: int) -> None:
    """Let the system end this process when its parent ends, where it can (Linux)."""
    if sys.platform != "linux":
        return
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # it ended in between
        os._exit(128 + signal.SIGKILL)
