"""Ends the process without notice just before its n-th change to the disk; loaded by Python itself when on its path.

`KILL_AT` says n; without it nothing happens. `COUNT_INTO` names a file that is given the number of changes at the end.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading

_lock = threading.Lock()
_count = 0
_at = int(os.environ.get("KILL_AT", "0"))
_into = os.environ.get("COUNT_INTO")

_CHANGES = {
    "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.utime", "os.truncate", "os.link", "os.symlink",
    "shutil.rmtree", "fsync",
}  # fmt: skip


def _changed() -> None:
    global _count
    with _lock:
        _count += 1
        if _count == _at:
            os.kill(os.getpid(), signal.SIGKILL)


def _hook(event: str, arguments: tuple) -> None:
    if event == "open":
        path, _, flags = arguments
        writes = isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if writes and isinstance(path, str) and not path.endswith((".pyc", ".nbi", ".nbc")):
            _changed()
    elif event in _CHANGES:
        _changed()


if _at or _into:
    sys.addaudithook(_hook)
    _fsync = os.fsync

    def fsync(descriptor: int) -> None:
        """As in `os`, and counted."""
        _changed()
        _fsync(descriptor)

    os.fsync = fsync

    def _write_count() -> None:
        count = _count
        with open(f"{_into}-{os.getpid()}", "w") as file:
            file.write(str(count))

    if _into:
        atexit.register(_write_count)
