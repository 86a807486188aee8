"""Files and folders of runs: digests, sizes, writing whole or not at all.

Every call that may change a finished file of a run is here, so that a test can let each of them fail.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

from sppm_pipeline.errors import ResourceError

_CHUNK = 1 << 16
"""Files of fewer bytes are read in one step; not sensitive: nearly all pictures of layers are smaller."""

DISK = "make room on the disk, or choose another place with -o; the same command again goes on"


def packaged_folder() -> Path:
    """The folder that holds `configs` and `examples`: in a wheel the package, in a checkout the one around it."""
    package = Path(__file__).resolve().parents[1]
    return package if (package / "configs").is_dir() else package.parent


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
        data = file.read(_CHUNK)
        digest, size = hashlib.sha256(data), len(data)
        if size == _CHUNK or file.read(1):  # nearly all are smaller, and need no buffer
            file.seek(0)
            digest, size = hashlib.file_digest(file, "sha256"), file.tell()
        return digest.hexdigest(), size


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


_NO_SYNC = frozenset({errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP})
"""Errors of a file system that can't sync this kind of file; its data are then as safe as it makes them."""


def sync(path: str | Path) -> None:
    """Wait until the disk has a file, or the names in a folder, where the file system can do that.

    `OSError` means that the disk failed: data may be lost though every write to the file succeeded.
    """
    if os.name == "nt" and os.path.isdir(path):  # folders can't be opened there
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        _sync_open(descriptor)
    finally:
        os.close(descriptor)


def _sync_open(descriptor: int) -> None:
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def sync_file_system(path: str | Path) -> bool:
    """Wait until the disk has everything of the file system in which `path` lies; False where there is no syncfs(2).

    `OSError` means that the disk failed, since Linux 5.8 also if it did so before this call.
    """
    if sys.platform != "linux":
        return False
    import ctypes

    libc = ctypes.CDLL(None, use_errno=True)
    if not hasattr(libc, "syncfs"):
        return False
    descriptor = os.open(path, os.O_RDONLY)
    try:
        if libc.syncfs(descriptor) != 0 and (number := ctypes.get_errno()) not in _NO_SYNC:
            raise OSError(number, os.strerror(number), os.fspath(path))
    finally:
        os.close(descriptor)
    return True


def make_folder(path: Path) -> set[Path]:
    """Make a folder and those above it; the folders with new names in them, which `sync` makes lasting."""
    missing = [folder for folder in (path, *path.parents) if not folder.is_dir()]
    path.mkdir(parents=True, exist_ok=True)
    return {folder.parent for folder in missing}


def put_into_place(staged: Path, final: Path, aside: Callable[[], Path]) -> set[Path]:
    """Move a finished file or folder to its name on the same file system, over what an earlier run left there.

    `aside` gives a path for what makes way: only a file takes the place of a file in one step. Returned are the folders
    with new names in them, which `sync` makes lasting.
    """
    changed = {final.parent, *make_folder(final.parent)}
    if (final.is_dir() or staged.is_dir()) and os.path.lexists(final):
        os.replace(final, aside())
    os.replace(staged, final)
    return changed


def write_whole(path: Path, text: str, *, durable: bool = True, mode: int | None = None) -> None:
    """Write a text file so that it is there whole or not at all; if `durable`, even if the machine stops.

    Permissions are `mode`, or those of any new file. `ResourceError` if the disk is full or a permission is missing.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            if mode is not None:
                os.chmod(temporary, mode)
            file.write(text)
            file.flush()
            if durable:
                _sync_open(file.fileno())
        os.replace(temporary, path)
        if durable:
            sync(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise ResourceError(f"can't write {str(path)!r}: {error.strerror}", hint=DISK) from error
