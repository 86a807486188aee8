"""Locks on folders that need no clearing up: they belong to an open descriptor and end with the process.

Where the system has no such locks (Windows, some network file systems), everybody gets the lock.
"""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path
from types import ModuleType

fcntl: ModuleType | None
try:
    import fcntl
except ImportError:
    fcntl = None


class FolderLock:
    """An exclusive lock on a folder or file that exists."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._descriptor: int | None = None

    def acquire(self, *, wait: bool = False) -> bool:
        """Take the lock; False if somebody else holds it.

        Raises
        ------
        FileNotFoundError
            If the folder is not there, or not there any more.
        """
        if fcntl is None:
            return True
        descriptor = os.open(self._path, os.O_RDONLY)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError as error:
            os.close(descriptor)
            if error.errno in (errno.EWOULDBLOCK, errno.EACCES):
                return False
            if error.errno in (errno.ENOTSUP, errno.ENOLCK, errno.EBADF, errno.ENOSYS):
                return True
            raise
        try:
            there = os.stat(self._path)
            same = os.path.samestat(there, os.fstat(descriptor))
        except FileNotFoundError:
            same = False
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
