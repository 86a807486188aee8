"""The guard of a worker of a sweep: ends the worker when a stage of it has used up its time. Run as a script.

A worker that is stuck in compiled code or stopped can't watch over itself, and the process that hands out its rows may
be on another machine. Its guard, a child of it, reads the page of activity as the supervisor does, and ends with it.
Standard input: the file that the worker shares, a line each time that it begins another row.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

LOOK = 0.25
"""Seconds between two looks; not sensitive: the grace that a stage has beyond its limit is longer."""

_guard: subprocess.Popen[bytes] | None = None


def guard(notes: Path) -> None:
    """Have the guard of this process, started when needed, watch the file that it shares now."""
    global _guard
    if _guard is None or _guard.poll() is not None:
        # isolated: neither the environment nor site packages, which take time and may hold faults
        command = [sys.executable, "-I", "-S", __file__, str(os.getpid())]
        _guard = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    assert _guard.stdin is not None
    _guard.stdin.write(os.fsencode(notes) + b"\n")
    _guard.stdin.flush()


def _main() -> None:
    # the package by its place, as it may be installed in a way that needs the `site` that is left out here
    sys.path.append(os.path.abspath(os.path.join(os.path.dirname(__file__), *[os.pardir] * 3)))
    from sppm_pipeline.engine.process import activity
    from sppm_pipeline.engine.process.tree import die_with_parent

    worker = int(sys.argv[1])
    die_with_parent(worker)
    for name in ("SIGINT", "SIGHUP"):  # the terminal sends them to all; the worker's parent decides
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    notes, before = None, 0.0
    # a guard whose worker is gone has another parent
    while os.getppid() == worker:
        if select.select([0], [], [], LOOK)[0]:
            lines = os.read(0, 1 << 16).splitlines()
            if not lines:
                return
            notes, before = Path(os.fsdecode(lines[-1])), 0.0
            continue
        if notes is None:
            continue
        with contextlib.suppress(OSError, ValueError):
            ends = min(activity.deadlines(notes))
            # twice the same, as the file may be read while it is written
            if ends == before and time.monotonic() > ends and os.getppid() == worker:
                activity.note_overdue(notes)
                os.kill(worker, signal.SIGKILL)
                return
            before = ends


if __name__ == "__main__":
    _main()
