"""Input files taken whole into memory, within bounds."""

from __future__ import annotations

import stat
from pathlib import Path

from sppm_pipeline.errors import InputError


def content_of(path: Path, limit: int) -> bytes:
    """The bytes of a file; what is no file (a folder, a pipe, a device) is not waited for.

    Raises
    ------
    InputError
        If it cannot be read, or has more than `limit` bytes.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            kinds = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
            kind = kinds.get(stat.S_IFMT(status.st_mode), "a device")
            raise InputError(f"{path} is no file, but {kind}", hint="give the path of a file")
        if status.st_size > limit:
            raise InputError(f"{path} has {status.st_size} bytes; the limit is {limit}", hint="simplify what is in it")
        with path.open("rb") as file:
            data = file.read(status.st_size + 1)
    except (OSError, ValueError) as error:  # a path with a NUL in it is a ValueError
        raise InputError(
            f"cannot read {path}: {getattr(error, 'strerror', None) or error}",
            hint="check the path and the permissions",
        ) from error
    if len(data) != status.st_size:
        raise InputError(f"{path} changed its size while it was read", hint="wait until it is written")
    return data
