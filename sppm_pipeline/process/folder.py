"""The private folder of a child, and what becomes of it when nobody is left to remove it.

A folder in use is locked by its owner with ``flock`` on the folder itself. The system gives the lock up when the owner
ends, however it ends; so a folder that can be locked belongs to nobody and is removed. There is no file to forget.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

PREFIX = "sppm-native-"


@contextlib.contextmanager
def private_folder() -> Iterator[Path]:
    """A folder that only this user may enter; it is gone with all it contains when the context ends."""
    remove_leftovers()
    path, lock = _locked_folder()
    try:
        yield path
    finally:
        _remove(path)
        os.close(lock)


def remove_leftovers() -> None:
    """Remove folders whose owners have died; those of living owners are left alone."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(tempfile.gettempdir())):
            if entry.name.startswith(PREFIX):
                with contextlib.suppress(OSError):
                    _remove_if_left(Path(entry.path))


def _remove_if_left(path: Path) -> None:
    there = path.lstat()
    if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.geteuid():
        return
    import fcntl

    if not there.st_mode & stat.S_IRUSR:
        path.chmod(0o700)
    lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        _remove(path)
    except BlockingIOError:
        pass
    finally:
        os.close(lock)


def _locked_folder() -> tuple[Path, int]:
    import fcntl

    while True:
        path = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = -1
        try:
            lock = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            fcntl.flock(lock, fcntl.LOCK_EX)
            # between its making and its locking, another run may have taken it for a leftover
            if os.path.samestat(os.stat(path), os.fstat(lock)):
                return path, lock
        except FileNotFoundError:
            pass
        if lock >= 0:
            os.close(lock)


def _remove(path: Path) -> None:
    """Remove a folder, also one whose inner folders were closed to their owner."""
    shutil.rmtree(path, ignore_errors=True)
    if path.exists():
        for folder, names, _ in os.walk(path):
            for name in names:
                inner = Path(folder, name)
                if not inner.is_symlink():
                    with contextlib.suppress(OSError):
                        inner.chmod(0o700)
        with contextlib.suppress(OSError):
            path.chmod(0o700)
        shutil.rmtree(path, ignore_errors=True)
