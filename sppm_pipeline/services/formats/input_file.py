"""Input files: opened within bounds, and read by third-party libraries that neither print nor fail in their own way."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
import stat
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from sppm_pipeline.errors import InputError, ResourceError


def require_file(path: Path, limit: int) -> int:
    """The size of a file of up to `limit` bytes; what is no file (a folder, a pipe, a device) is not waited for."""
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
            kind = kinds.get(stat.S_IFMT(status.st_mode), "a device")
            raise InputError(f"{path} is no file, but {kind}", hint="give the path of a file")
        with path.open("rb"):
            pass
    except (OSError, ValueError) as error:  # a path with a NUL in it is a ValueError
        raise _unreadable(path, error) from error
    if status.st_size > limit:
        raise InputError(f"{path} has {status.st_size} bytes; the limit is {limit}", hint="simplify what is in it")
    return status.st_size


def content_of(path: Path, limit: int) -> bytes:
    """The bytes of a file.

    Raises
    ------
    InputError
        If it cannot be read, has more than `limit` bytes, or changes while it is read.
    """
    size = require_file(path, limit)
    try:
        with path.open("rb") as file:
            data = file.read(size + 1)
    except OSError as error:
        raise _unreadable(path, error) from error
    if len(data) != size:
        raise InputError(f"{path} changed its size while it was read", hint="wait until it is written")
    return data


def _unreadable(path: Path, error: Exception) -> InputError:
    return InputError(
        f"cannot read {path}: {getattr(error, 'strerror', None) or error}", hint="check the path and the permissions"
    )


def library(module: str, extra: str) -> ModuleType:
    """Import a library that an optional extra of this program installs; a ResourceError if it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ResourceError(
            f"files of this kind are read by the library {module.partition('.')[0]}, which is not installed",
            hint=f"pip install 'sppm-pipeline[{extra}]'",
        ) from error


@contextlib.contextmanager
def third_party_reader(module: str, name: str, hint: str | None = None) -> Iterator[None]:
    """Run a library that reads a file: it prints, warns and logs nothing, and whatever it raises is an InputError.

    The module is also the name of its logger.
    """
    logger = logging.getLogger(module)
    before = logger.disabled
    logger.disabled = True
    try:
        with (
            contextlib.redirect_stdout(io.StringIO()),
            contextlib.redirect_stderr(io.StringIO()),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            yield
    except (MemoryError, InputError, ResourceError):
        raise
    except (Exception, SystemExit) as error:  # a mistake in a file may surface as anything
        words = (str(error).splitlines() or [""])[0][:120]
        raise InputError(
            f"{name} cannot be read by {module}: {type(error).__name__} {words}".rstrip(), hint=hint
        ) from error
    finally:
        logger.disabled = before
