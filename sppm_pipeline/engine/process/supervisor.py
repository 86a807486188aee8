"""The process between the main process and the worker. Run as a script.

The worker may be stuck in native code and the main process be killed at any time; this process does nothing but wait.
It ends the worker and every process below it when its standard input is closed, which happens when the parent closes it
or dies, and also when the worker has ended. On Linux, orphaned descendants are handed to it ("subreaper"), so that one
that has left the worker's process group is found, too; elsewhere only the group is ended.

Arguments: number of the parent process, file descriptor of the progress pipe, path of the worker script, private
folder, and the folder from which psutil is loaded (only if there is something left to end).
Standard input: the life line. Standard output: how the worker ended, one line. Standard error: the worker's output.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import time

GIVE_UP = 5.0
"""Seconds after which killed processes that do not go away (they wait for a device) are left to the system."""


def main() -> None:
    """Start the worker, watch, and clear up."""
    parent, progress, script, folder, libraries = int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:]
    # our own package by its place, as it may be installed in a way that needs the `site` that is left out here
    sys.path += [os.path.abspath(os.path.join(os.path.dirname(__file__), *[os.pardir] * 3)), libraries]
    from sppm_pipeline.engine.process.tree import adopt_orphans, die_with_parent

    woken, wake = os.pipe()
    os.set_blocking(woken, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    requests: list[int] = []
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.signal(signal.SIGTERM, lambda number, frame: requests.append(number))
    signal.pthread_sigmask(signal.SIG_SETMASK, ())
    adopt_orphans()
    die_with_parent(parent, signal.SIGTERM)  # the life line may have been inherited by a fork of the parent
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
    # or the reader of the pipe would never see its end
    os.close(progress)
    status = None
    while status is None and not requests:
        ready = select.select([0, woken], [], [])[0]
        if 0 in ready and not os.read(0, 1024):
            break
        if woken in ready:
            os.read(woken, 1024)
        pid, raw = os.waitpid(worker, os.WNOHANG)
        if pid:
            status = os.waitstatus_to_exitcode(raw)
    _kill_all(worker)
    os.write(1, f"{'stopped' if status is None else status}\n".encode())


def _kill_all(worker: int) -> None:
    """Kill everything below this process, again and again, as the children of what was killed become its own."""
    from sppm_pipeline.engine.process.tree import signal_below

    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(worker, signal.SIGKILL)
    until = time.monotonic() + GIVE_UP
    while time.monotonic() < until:
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:
            return
        signal_below(os.getpid(), signal.SIGKILL)
        time.sleep(0.002)


if __name__ == "__main__":
    main()
