"""The memory that this process takes while something goes on: its largest resident size, although that only grows.

And how to take less of it where there are threads.
"""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType

from sppm_pipeline.engine.process.budget import held_memory

PERIOD = 0.05
"""Seconds between two looks, each of which takes 0.1 ms: 0.2 % of a processor; shorter peaks are missed. To have Linux
forget the highest (`/proc/self/clear_refs`) would be exact, but those who start the program and ask the system
afterwards for the most it took would see too little."""

LINGER = 1.0
"""Seconds that the looking thread waits for something else to begin: to start one costs as much as half a look."""

_ARENA_MAX = -8  # M_ARENA_MAX in glibc's malloc.h

_watched: list[PeakWatch] = []
_looking = threading.Lock()
_thread: threading.Thread | None = None


class PeakWatch:
    """Watches the memory of this process and of all its threads, native children left out, while it is entered.

    `mb` is the largest resident size, MB: exact if there was none larger before, else the largest seen every `PERIOD`.
    """

    mb = 0.0

    def __enter__(self) -> PeakWatch:
        self._highest = highest()
        self.most = held_memory()[0]
        _watched.append(self)
        _look()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        _watched.remove(self)
        after = highest()
        most = after if after > self._highest else max(self.most, held_memory()[0])
        self.mb = round(most / 1e6, 1)


def highest() -> int:
    """Bytes of this process that were in memory at most so far; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else 1024 * peak)


def _look() -> None:
    """Have the thread run. Who watches has said so before, so that a thread about to end, under the lock, sees it."""
    global _thread
    with _looking:
        if _thread is None or not _thread.is_alive():
            _thread = threading.Thread(target=_look_on, name="sppm-memory", daemon=True)
            _thread.start()


def _look_on() -> None:
    global _thread
    idle = 0.0
    while True:
        time.sleep(PERIOD)
        if _watched:
            idle, now = 0.0, held_memory()[0]
            for one in tuple(_watched):
                one.most = max(one.most, now)
            continue
        idle += PERIOD
        if idle >= LINGER:
            with _looking:
                if not _watched:
                    _thread = None
                    return


def share_one_heap() -> bool:
    """Let threads allocate from one heap, where the system's library (glibc) would give each its own; whether it does.

    Threads here allocate rarely, but megabytes: heaps of their own keep what they have freed from all others, 35 MB in
    a run of two threads. To be called before there are threads.
    """
    if not sys.platform.startswith("linux"):
        return False
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    return mallopt is not None and mallopt(_ARENA_MAX, 1) == 1
