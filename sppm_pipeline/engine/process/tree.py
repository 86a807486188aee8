"""The processes below one in the tree of processes: ending them, and ending with one's parent.

Only the standard library is imported at the top, and little of it: the supervisor of a native child starts with this.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36
"""Options of prctl(2)."""


def signal_below(pid: int, number: int, *, recursive: bool = True) -> None:
    """Send a signal to all processes below one, orphans that it adopted included, but not to itself.

    Unless `recursive`, only its children get it.
    """
    # if psutil can't be loaded any more (no descriptor is left), `die_with_parent` is what remains
    with contextlib.suppress(ImportError, OSError):
        import psutil

        with contextlib.suppress(psutil.Error):
            # a snapshot: children that appear meanwhile are found by those who call again
            for process in psutil.Process(pid).children(recursive=recursive):
                with contextlib.suppress(psutil.Error):  # it has ended, or belongs to another user
                    process.send_signal(number)


def resident_below(pid: int) -> int:
    """Bytes of their own that a process and all below it hold in memory; pages of files, which they share, left out."""
    total = 0
    with contextlib.suppress(ImportError, OSError):
        import psutil

        with contextlib.suppress(psutil.Error):
            first = psutil.Process(pid)
            for process in (first, *first.children(recursive=True)):
                with contextlib.suppress(psutil.Error):
                    # libraries are mapped by every process of a sweep, and in memory once
                    held = process.memory_info()
                    total += held.rss - getattr(held, "shared", 0)
    return total


def die_with_parent(parent: int, number: int = signal.SIGKILL) -> None:
    """Have the system send this process a signal when its parent ends, where it can (Linux)."""
    if sys.platform == "linux":
        _prctl(_PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:  # it ended in between
        os._exit(128 + signal.SIGKILL)


def adopt_orphans() -> None:
    """Become the parent of processes below this one whose parents end, where the system can do that (Linux)."""
    if sys.platform == "linux":
        _prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _prctl(option: int, value: int) -> None:
    import ctypes

    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)
