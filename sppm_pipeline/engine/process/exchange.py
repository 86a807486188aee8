"""Exchange with a native child: a private folder, arrays in .npy files, and progress through a pipe.

The folder is locked by its owner, on the folder itself. The system releases the lock when the owner ends, however it
ends; so a folder that can be locked has no owner and is removed.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.engine.locks import FolderLock

PREFIX = "sppm-native-"
"""Prefix of the names of private folders."""

LONGEST_LINE = 511
"""Bytes of a line; with its end any system writes it to a pipe in one piece."""

_LONGEST_STEP = 36
"""Characters of a step's name; JSON makes up to six bytes of each, of the rarest twelve."""

_channel: int | None = None


class ArraySpec(NamedTuple):
    """Type and shape of an array that the child returns.

    Attributes
    ----------
    dtype : str
        Exactly this type: ``"float64"``.
    shape : tuple of int or None
        Length of each axis; None stands for any.
    """

    dtype: str
    shape: tuple[int | None, ...]

    def __str__(self) -> str:
        return f"{self.dtype} of shape ({', '.join('any' if n is None else str(n) for n in self.shape)})"

    def problem(self, array: NDArray[Any]) -> str | None:
        """Reason why `array` does not fit, or None."""
        fits = len(array.shape) == len(self.shape) and all(
            wanted in (None, there) for wanted, there in zip(self.shape, array.shape, strict=True)
        )
        if array.dtype != np.dtype(self.dtype) or not fits:
            return f"is {array.dtype} of shape {array.shape}, expected {self}"
        if array.dtype.kind in "fc" and not np.isfinite(array).all():
            return f"has {int(np.count_nonzero(~np.isfinite(array)))} values that are not finite"
        return None


def write_arrays(folder: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write each array to ``<name>.npy``; `ValueError` if a name is no identifier or a value no array of numbers."""
    for name, array in arrays.items():
        if not name.isidentifier():
            raise ValueError(f"the name of an array must be an identifier, got {name!r}")
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biufc":
            kind = f"an array of {array.dtype}" if isinstance(array, np.ndarray) else f"a {type(array).__name__}"
            raise ValueError(f"{name!r} must be an array of numbers, got {kind}")
        np.save(folder / f"{name}.npy", array, allow_pickle=False)


def read_arrays(folder: Path, returns: Mapping[str, ArraySpec]) -> dict[str, NDArray[Any]]:
    """Read the expected arrays; `ValueError` if one is missing, incomplete or not as expected."""
    arrays = {}
    for name, spec in returns.items():
        path = folder / f"{name}.npy"
        if not path.is_file():
            raise ValueError(f"the array {name!r} is missing")
        try:
            # mapped first: header and size of the file are compared before memory is asked for
            array = np.array(np.lib.format.open_memmap(path, mode="r")) if path.stat().st_size > 4096 else np.load(path)
        except (ValueError, OSError, EOFError) as error:
            raise ValueError(f"the array {name!r} can't be read: {error}") from None
        wrong = spec.problem(array)
        if wrong is not None:
            raise ValueError(f"the array {name!r} {wrong}")
        arrays[name] = array
    return arrays


@contextlib.contextmanager
def private_folder() -> Iterator[Path]:
    """A folder that only this user may enter; it is gone with all it contains when the context ends."""
    remove_leftovers()
    taken = False
    while not taken:
        path = Path(tempfile.mkdtemp(prefix=PREFIX))
        lock = FolderLock(path)
        # between its making and its locking, another run may have taken it for a leftover
        with contextlib.suppress(FileNotFoundError):
            taken = lock.acquire()
    try:
        yield path
    finally:
        _remove(path)
        lock.release()


def remove_leftovers() -> None:
    """Remove folders whose owners have died; those of living owners are left alone."""
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(tempfile.gettempdir())):
            if entry.name.startswith(PREFIX):
                with contextlib.suppress(OSError):
                    _remove_if_left(Path(entry.path))


def _remove_if_left(path: Path) -> None:
    # no link is followed: the temporary folder is open to all users
    there = path.lstat()
    if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.geteuid():
        return
    if not there.st_mode & stat.S_IRUSR:
        path.chmod(0o700)
    lock = FolderLock(path)
    if lock.acquire():
        _remove(path)
        lock.release()


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


def connect(channel: int) -> None:
    """Send notifications through this file descriptor from now on; the worker calls it once."""
    global _channel
    _channel = channel


def notify(step: str, done: float = 0, total: float = 0) -> None:
    """Report the step that begins now, and the progress.

    To be called in the child: if it dies or runs out of time, the error names the last reported step. Anywhere else
    this does nothing, so that the function can be called and tested without a child.

    Parameters
    ----------
    step : str
        What is being done, as a person would call it: ``"close holes"``; cut after 36 characters.
    done, total : float
        Progress in any unit; without a total only the step is reported.
    """
    global _channel
    if _channel is None:
        return
    line = json.dumps([step[:_LONGEST_STEP], float(done), float(total)])
    try:
        os.write(_channel, line.encode() + b"\n")
    except OSError:  # the library has closed what it did not open; the result matters more than its progress
        _channel = None
