"""Sizes and digests of the files of a run, and the wait until the disk has them: both by threads, beside the stages."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sppm_pipeline.engine.files import file_digest, files_in, sync, sync_file_system, tree_digest

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

_AnyPath = TypeVar("_AnyPath", bound="str | Path")

_FILES_PER_TASK = 16
"""Files that one task of the threads reads or syncs; not sensitive: enough that the queue costs nothing."""

MAX_SYNCED = 4096
"""Files that are synced one by one; more are by one syncfs(2) at the end, as each file costs the disk a commit."""


class WrittenFiles:
    """The outputs of a run: what each is described by in the record, and whether the disk has them."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._sums: dict[str, str] = {}
        self._hashed: dict[str, tuple[int, int, str]] = {}
        self._syncing: list[Future[None]] = []
        self._folders: set[str] = set()
        self._unsynced: list[str] = []
        self._begun = 0
        self._pool: ThreadPoolExecutor | None = None

    def hashed(self, name: str, path: Path, sha256: str) -> None:
        """Take the digest of a file from its writer; it counts as long as the file is left as it is."""
        about = path.stat()
        self._hashed[name] = (about.st_size, about.st_mtime_ns, sha256)

    def described(self, name: str, path: Path) -> dict[str, Any]:
        """Size, number of files and digest of an output that lies at `path`."""
        folder = path.is_dir()
        inside = files_in(path) if folder else [""]
        about = path.stat()
        # a writer that hashed while it wrote saves reading gigabytes again; size and time tell later changes
        size, time, known = self._hashed.pop(name, (-1, -1, ""))
        if not folder and (size, time) == (about.st_size, about.st_mtime_ns):
            read = [(known, size)]
        elif len(inside) > 1:
            names = [os.path.join(path, relative) for relative in inside]
            read = [one for part in self._workers().map(_digests, _parts(names)) for one in part]
        else:
            read = [file_digest(path / relative if relative else path) for relative in inside]
        digests = [digest for digest, _ in read]
        described: dict[str, Any] = {"path": name, "bytes": sum(size for _, size in read)}
        if folder:
            described["files"] = len(inside)
            described["sha256"] = tree_digest(dict(zip(inside, digests, strict=True)))
        else:
            described["sha256"] = digests[0]
        for relative, digest in zip(inside, digests, strict=True):
            self._sums[f"{name}/{relative}" if relative else name] = digest
        return described

    def sums(self, outputs: Collection[str]) -> str:
        """Digests of all files of these outputs, as ``sha256sum -c`` reads them; a line for each file."""
        return "".join(
            f"{digest}  {name}\n"
            for name, digest in sorted(self._sums.items())
            if any(name == output or name.startswith(f"{output}/") for output in outputs)
        )

    def sync(self, path: Path, renamed_in: Collection[Path] = ()) -> None:
        """Begin to wait until the disk has an output, and remember the folders whose names have changed."""
        inside = files_in(path) if path.is_dir() else None
        files = [str(path)] if inside is None else [os.path.join(path, name) for name in inside]
        self.changed(renamed_in)
        if inside is not None:
            # names in a folder are data of the folder: without its sync a file may be there without a name
            self._folders |= {str(path), *(os.path.dirname(file) for file in files)}
        left = max(0, MAX_SYNCED - self._begun)
        self._begun += len(files)
        self._unsynced += files[left:]
        for part in _parts(files[:left]):
            self._syncing.append(self._workers().submit(_sync_all, part))

    def changed(self, folders: Collection[Path]) -> None:
        """Remember folders in which names have changed."""
        self._folders |= {os.fspath(folder) for folder in folders}

    def settle(self) -> None:
        """Wait until the disk has all of them; `OSError` if it failed to take one."""
        # every job is waited for, so that none touches a file after an error was reported
        errors = [error for job in self._syncing if (error := job.exception()) is not None]
        self._syncing.clear()
        if errors:
            raise errors[0]
        if self._unsynced and not sync_file_system(os.path.dirname(self._unsynced[0])):
            _sync_all(self._unsynced)
        self._unsynced.clear()
        _sync_all(sorted(self._folders))
        self._folders.clear()

    def close(self) -> None:
        """End the threads, whatever they still wait for."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _workers(self) -> ThreadPoolExecutor:
        if self._pool is None:
            from concurrent.futures import ThreadPoolExecutor

            self._pool = ThreadPoolExecutor(max(2, self._threads), thread_name_prefix="sppm-files")
        return self._pool


def _parts(paths: Sequence[_AnyPath]) -> list[Sequence[_AnyPath]]:
    return [paths[first : first + _FILES_PER_TASK] for first in range(0, len(paths), _FILES_PER_TASK)]


def _sync_all(paths: Sequence[str | Path]) -> None:
    for path in paths:
        sync(path)


def _digests(paths: Sequence[str]) -> list[tuple[str, int]]:
    return [file_digest(path) for path in paths]
