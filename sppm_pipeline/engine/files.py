"""Files and folders as the engine handles them: digests, sizes, writing whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from sppm_pipeline.errors import ResourceError

_AT_ONCE = 1 << 16
"""Bytes of the files that are read in one step."""

DISK = "make room on the disk, or choose another place with -o; the same command again goes on"


def files_in(path: Path) -> list[str]:
    """Names of all files below a folder, in order, relative to it, with slashes; links to folders are not followed."""
    found: list[str] = []
    waiting = [""]
    while waiting:
        below = waiting.pop()
        with contextlib.suppress(PermissionError), os.scandir(os.path.join(path, below)) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(f"{below}{entry.name}/")
                    continue
                with contextlib.suppress(OSError):  # a link that leads to itself is no file
                    if entry.is_file():
                        found.append(below + entry.name)
    return sorted(found)


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files below a folder."""
    return sum((path / name).stat().st_size for name in files_in(path)) if path.is_dir() else path.stat().st_size


def tree_digest(digests: Mapping[str, str]) -> str:
    """SHA-256 of a folder, from the names and digests of its files."""
    total = hashlib.sha256()
    for name in sorted(digests):
        total.update(f"{name}\0{digests[name]}\n".encode())
    return total.hexdigest()


def digest_of(path: Path) -> str:
    """SHA-256 of a file; of a folder, over the names and digests of its files in order of their names."""
    if path.is_dir():
        return tree_digest({name: file_digest(os.path.join(path, name))[0] for name in files_in(path)})
    return file_digest(path)[0]


def file_digest(path: str | Path) -> tuple[str, int]:
    """SHA-256 and size of a file."""
    with open(path, "rb", buffering=0) as file:
        data = file.read(_AT_ONCE)
        if len(data) < _AT_ONCE and not file.read(1):  # nearly all are, and need no buffer
            return hashlib.sha256(data).hexdigest(), len(data)
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest(), file.tell()


def remove(path: Path) -> None:
    """Remove a file or a folder if it is there; of a link, the link."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def clear(path: Path) -> None:
    """Remove a folder as far as possible; of a link, the link.

    Takes one descriptor at a time, which `shutil.rmtree` does not make do with.
    """
    if path.is_symlink() or not path.is_dir():
        with contextlib.suppress(OSError):
            path.unlink()
        return
    for folder, folders, files in os.walk(path, topdown=False):
        for name in (*files, *folders):
            inside = os.path.join(folder, name)
            with contextlib.suppress(OSError):
                (os.rmdir if name in folders and not os.path.islink(inside) else os.unlink)(inside)
    with contextlib.suppress(OSError):
        os.rmdir(path)


def sync(path: str | Path) -> None:
    """Wait until the disk has a file, where the file system can tell; else its digest says whether it is whole."""
    with contextlib.suppress(OSError):
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def write_whole(path: Path, text: str, *, durable: bool = True, mode: int | None = None) -> None:
    """Write a text file so that it is there whole or not at all; if `durable`, even if the machine stops.

    Permissions are `mode`, or those of any new file.

    Raises
    ------
    ResourceError
        If the disk is full or a permission is missing.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            if mode is not None:
                os.chmod(temporary, mode)
            file.write(text)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ResourceError(f"can't write {str(path)!r}: {error.strerror}", hint=DISK) from error
