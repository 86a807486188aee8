"""Locks on folders and files: by ``flock``, and for a folder on a file system without it by a claim file."""

from __future__ import annotations

import contextlib
import datetime
import errno
import os
import socket
import threading
import time
from pathlib import Path
from types import ModuleType

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:
    fcntl = None

CLAIM = ".claim"
"""Name of the file by which a folder is claimed where the file system has no ``flock``, as some of clusters."""

HEARTBEAT = 30.0
"""Seconds between two heartbeats in a claim file. Heuristic: half of it means twice the writes on a shared file system,
twice of it that the claim of a dead process lasts twice as long."""

SILENCE = 3
"""Missed heartbeats after which a claim is taken for dead. Heuristic: a network file system may delay some; with twice
as many, a run waits twice as long for one that was killed."""

POLL = 0.05
"""Seconds between two looks at a claim that is waited for."""

_MISSING = (errno.ENOTSUP, errno.ENOLCK, errno.EBADF, errno.ENOSYS)


class FolderLock:
    """An exclusive lock on a folder or file that exists.

    The system gives a ``flock`` back when its process ends. A claim file stays when its process is killed: only a
    person removes it, because no process can know whether one of another machine has ended. A *file* is not claimed:
    what it holds, an account, may then be off. After `acquire` has failed, `holder` says who holds the lock, as far as
    that is known.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None
        self._claim: _Claim | None = None
        self.holder = ""

    def acquire(self, *, wait: bool = False) -> bool:
        """Take the lock; False if another process holds it, `FileNotFoundError` if the folder is not there any more.

        With `wait` it waits until the lock is given back. It is False even then if the lock is a claim file whose
        process gives no sign of life, for it may be gone.
        """
        if fcntl is None:
            return self._claimed(wait)
        descriptor = os.open(self._path, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError as error:
            os.close(descriptor)
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                return False
            if error.errno in _MISSING:
                return self._claimed(wait)
            raise
        try:
            there = os.stat(self._path)
            same = os.path.samestat(there, os.fstat(descriptor))
        except FileNotFoundError:
            same = False
        except OSError:
            os.close(descriptor)
            raise
        if not same:  # removed between opening and locking
            os.close(descriptor)
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self._path))
        self._descriptor = descriptor
        return True

    def release(self) -> None:
        """Give the lock back; may be called twice."""
        if self._descriptor is not None:
            with contextlib.suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = None
        if self._claim is not None:
            self._claim.release()
            self._claim = None

    def _claimed(self, wait: bool) -> bool:
        if not self._path.is_dir():
            return True
        claim = self._path / CLAIM
        heard, since = None, time.monotonic()
        while True:
            try:
                self._claim = _Claim(claim)
            except FileExistsError:
                pass
            else:
                return True
            now = _heard(claim)
            if now != heard:  # by its own clock, which another machine may have set otherwise
                heard, since = now, time.monotonic()
            if not wait or time.monotonic() - since > SILENCE * HEARTBEAT:
                self.holder = _told(claim)
                return False
            time.sleep(POLL)


class _Claim:
    """A file that this process alone has made; its time of change is a sign of life."""

    def __init__(self, path: Path) -> None:
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
        try:
            with os.fdopen(descriptor, "w", encoding="utf-8") as file:
                file.write(f"process {os.getpid()} on {socket.gethostname()} since {_moment(None)}\n")
                self._own = os.fstat(file.fileno())
        except BaseException:  # a full disk; an empty claim would have no owner
            with contextlib.suppress(OSError):
                path.unlink()
            raise
        self._path = path
        self._over = threading.Event()
        threading.Thread(target=self._live, name="sppm-claim", daemon=True).start()

    def release(self) -> None:
        """Let others use the folder."""
        self._over.set()
        with contextlib.suppress(OSError):
            if os.path.samestat(self._own, os.stat(self._path)):  # not that of a process that took this one for dead
                self._path.unlink()

    def _live(self) -> None:
        while not self._over.wait(HEARTBEAT):
            with contextlib.suppress(OSError):
                os.utime(self._path)


def _heard(claim: Path) -> int | None:
    """When a claim's process has last given a sign of life, in nanoseconds of the file system; None if it is gone."""
    try:
        return claim.stat().st_mtime_ns
    except OSError:
        return None


def _told(claim: Path) -> str:
    """Content of a claim file and the time of its last heartbeat; empty if it has just gone."""
    try:
        text = claim.read_text("utf-8", "replace")[:200].strip()
        heard = claim.stat().st_mtime
    except OSError:
        return ""
    return f"{text}, last heard of at {_moment(heard)}; if it is gone, remove {str(claim)!r}"


def _moment(seconds: float | None) -> str:
    now = datetime.datetime.now(datetime.UTC)
    moment = now if seconds is None else datetime.datetime.fromtimestamp(seconds, datetime.UTC)
    return moment.isoformat(sep=" ", timespec="seconds").replace("+00:00", " UTC")
