"""The process between us and the worker. Run as a script; nothing but the standard library, and little of it.

The worker may be stuck in native code, so it can't watch over itself; and we may be killed at any time, so we can't
do it either. This process does nothing else. It ends the worker and every process that descends from it when its
standard input is closed, which happens when the parent closes it or dies; and also when the worker has ended.

On Linux, orphaned descendants are handed to it ("subreaper"), so that one that has left the worker's process group is
found, too. Elsewhere only the worker's group is ended.

Arguments: number of the parent process, file descriptor of the progress pipe, path of the worker script, folder.
Standard input: the life line. Standard output: how the worker ended, one line. Standard error: the worker's output.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time

__all__: list[str] = []

GIVE_UP = 5.0
"""Seconds after which killed processes that do not go away (they wait for a device) are left to the system."""

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36


def _prctl(option: int, value: int) -> None:
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(option, ctypes.c_ulong(value), 0, 0, 0)


def _children() -> list[int]:
    """Our children, also adopted ones."""
    found = []
    for name in os.listdir("/proc") if sys.platform == "linux" else ():
        if name.isdigit():
            try:
                with open(f"/proc/{name}/stat", "rb") as file:
                    # the name of the program, in parentheses, may contain anything
                    parent = int(file.read().rpartition(b")")[2].split()[1])
            except (OSError, ValueError, IndexError):
                continue
            if parent == os.getpid():
                found.append(int(name))
    return found


def _kill_all(worker: int) -> None:
    """End everything below us. The children of what was killed become ours, so it is repeated until none is left."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(worker, signal.SIGKILL)
    until = time.monotonic() + GIVE_UP
    while time.monotonic() < until:
        for child in _children():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(child, signal.SIGKILL)
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        time.sleep(0.002)


def main() -> None:
    """Start the worker, watch, and clear up."""
    parent, progress, script, folder = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
    woken, wake = os.pipe()
    os.set_blocking(woken, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    asked: list[int] = []
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.signal(signal.SIGTERM, lambda number, frame: asked.append(number))
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    _prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)  # the life line may have been inherited by a fork of the parent
    if os.getppid() != parent:
        return
    os.set_inheritable(progress, True)
    worker = os.posix_spawn(
        sys.executable,
        [sys.executable, "-P", script, str(os.getpid()), str(progress), folder],
        os.environ,
        file_actions=[(os.POSIX_SPAWN_OPEN, 0, os.devnull, os.O_RDONLY, 0), (os.POSIX_SPAWN_DUP2, 2, 1)],
        setpgroup=0,
        setsigdef=[number for number in signal.valid_signals() if number not in (signal.SIGKILL, signal.SIGSTOP)],
        setsigmask=(),
    )
    os.close(progress)
    ending = None
    while ending is None and not asked:
        ready = select.select([0, woken], [], [])[0]
        if 0 in ready and not os.read(0, 1024):
            break
        if woken in ready:
            os.read(woken, 1024)
        pid, status = os.waitpid(worker, os.WNOHANG)
        if pid:
            ending = os.waitstatus_to_exitcode(status)
    _kill_all(worker)
    os.write(1, f"{'stopped' if ending is None else ending}\n".encode())


if __name__ == "__main__":
    main()
