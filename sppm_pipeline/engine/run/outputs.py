"""The run directory: files appear in it whole or not at all, and never outside it."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import secrets
import socket
import threading
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sppm_pipeline.engine.config.document import RECORD_KEY
from sppm_pipeline.engine.config.names import REPORT, STAGING, collide, folded, output_parts
from sppm_pipeline.engine.files import (
    DISK,
    clear,
    file_digest,
    files_in,
    make_folder,
    put_into_place,
    remove,
    size_of,
    sync,
    sync_file_system,
    tree_digest,
    write_whole,
)
from sppm_pipeline.engine.locks import CLAIM, FolderLock
from sppm_pipeline.errors import ConfigError, PluginError, ResourceError

if TYPE_CHECKING:
    from concurrent.futures import Future, ThreadPoolExecutor

RECORD = "run.json"
SUMS = "SHA256SUMS"
SWEEP_RUNS = "runs"


def staging_name() -> str:
    """A name in a run directory that no process of any machine has given."""
    host = "".join(char for char in socket.gethostname()[:64] if char.isalnum() or char in "-.")
    return f"{STAGING}{host}-{os.getpid()}-{secrets.token_hex(3)}"


class RunFolder:
    """A run directory with its staging area; `threads` read files to compute their digests.

    Files of an earlier run stay until those of this run take their place, so that an interrupted run loses nothing.
    Names in `earlier` were left by that run, or are about to be written, and no finished stage of this run accounts for
    them yet.
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        self.path = path
        self.earlier: set[str] = set()
        self._files = WrittenFiles(threads)
        self._staging = path / staging_name()
        self._claims: dict[tuple[str, ...], tuple[str, str]] = {}
        self._pending: dict[str, Path] = {}
        self._places = 0
        self._lock = threading.Lock()
        self._folder_lock = FolderLock(path)

    def prepare(self) -> None:
        """Make the directory and lock it, or take over that of an earlier run.

        `ConfigError` if it holds something else, `ResourceError` if it can't be written or another run is writing into
        it.
        """
        try:
            if self.path.exists() and not self.path.is_dir():
                raise ConfigError(f"{str(self.path)!r} is a file, not a run directory", hint="choose another with -o")
            self._files.changed(make_folder(self.path))
            if not os.access(self.path, os.W_OK | os.X_OK):
                raise PermissionError(13, "Permission denied")
            # the lock comes first: what lies there may be judged only when no other run changes it
            if not self._folder_lock.acquire():
                holder = self._folder_lock.holder
                raise ResourceError(
                    f"another run is writing into {str(self.path)!r}" + (f": {holder}" if holder else ""),
                    hint="wait until it has ended, or choose another directory with -o",
                )
            if not is_run(self.path):
                raise ConfigError(
                    f"the folder {str(self.path)!r} is not empty and holds no earlier run",
                    hint="choose another with -o; nothing of yours is overwritten",
                )
            # only the holder of the lock may remove what an interrupted run has left
            _remove_unfinished(self.path)
            self.earlier = set(_recorded_outputs(self.path))
            remove(self.path / REPORT)  # it describes the earlier run
        except OSError as error:
            self._folder_lock.release()
            raise ResourceError(
                f"can't use the run directory {str(self.path)!r}: {error.strerror}", hint="choose another with -o"
            ) from error
        except ConfigError:
            self._folder_lock.release()
            raise

    def claim(self, stage: str, name: str) -> Path:
        """A path in the staging area for the output `name` of a stage; see `Context.output`."""
        parts = output_parts(name)
        key = folded(parts)
        with self._lock:
            # names that differ in case only, or where one is a folder of the other, collide on some file systems
            for other, (owner, other_name) in self._claims.items():
                if collide(other, key) and (owner != stage or other != key):
                    raise ConfigError(
                        f"the output {name!r} collides with {other_name!r} of stage {owner!r}",
                        hint="give one of them another path",
                    )
            final = self.path.joinpath(*parts)
            # a link inside of the run directory must not lead an output to files elsewhere
            if not final.parent.resolve().is_relative_to(self.path.resolve()):
                raise ConfigError(f"the output {name!r} leaves the run directory through a link")
            self._claims[key] = (stage, name)
            staged = self._staging.joinpath(*parts)
            staged.parent.mkdir(parents=True, exist_ok=True)
            self._pending["/".join(parts)] = staged
            return staged

    def restart(self, stage: str) -> None:
        """Forget what a stage of a recipe has written in an earlier draw."""
        with self._lock:
            for key in [key for key, (owner, _) in self._claims.items() if owner == stage]:
                name = "/".join(output_parts(self._claims.pop(key)[1]))
                if name in self._pending:
                    remove(self._pending.pop(name))

    def pending(self) -> set[str]:
        """Names that `commit` would move into place."""
        with self._lock:
            return set(self._pending)

    def commit(self, only: str | None = None) -> list[dict[str, Any]]:
        """Move what was staged, or only the outputs of the stage `only`, into place; paths, sizes and digests.

        `PluginError` if a stage asked for an output and did not write it, `ResourceError` if it can't be moved.
        """
        with self._lock:
            # a rejected stage leaves its own report; files of recipes of the same step stay in the staging area
            meant = {"/".join(output_parts(name)) for owner, name in self._claims.values() if only in (None, owner)}
            pending = {name: staged for name, staged in self._pending.items() if name in meant}
            self._pending = {name: staged for name, staged in self._pending.items() if name not in meant}
        for name, staged in pending.items():
            if not staged.exists():
                raise PluginError(f"the output {name!r} was announced but not written")
        try:
            # digests are of what the stage wrote, before anything else can touch it
            outputs = [self._files.described(name, staged) for name, staged in pending.items()]
            for name, staged in pending.items():
                final = self.path / name
                self._files.sync(final, put_into_place(staged, final, self._aside))
        except OSError as error:
            self.earlier |= set(pending)  # some are in place, and no stage accounts for them
            raise ResourceError(f"can't put the output {name!r} into place: {error.strerror}", hint=DISK) from error
        self.earlier -= set(pending)
        return outputs

    def holds(self, stage: str, outputs: Sequence[Mapping[str, Any]]) -> bool:
        """True if the directory holds exactly these outputs already, to the byte; they are then the stage's."""
        try:
            for output in outputs:
                path = self.path.joinpath(*output_parts(output["path"]))
                # sizes first: most changes show there, and reading gigabytes is not needed then
                if path.is_symlink() or path.is_dir() != ("files" in output) or size_of(path) != output["bytes"]:
                    return False
            if any(self._files.described(o["path"], self.path / o["path"]) != o for o in outputs):
                return False
            for output in outputs:
                self.claim(stage, output["path"])
        except OSError:
            return False
        with self._lock:
            for output in outputs:
                self._pending.pop(output["path"], None)
        self.earlier -= {output["path"] for output in outputs}
        return True

    def hashed(self, name: str, sha256: str) -> None:
        """Take the digest of a staged file from its writer; it counts as long as the file is left as it is."""
        name = "/".join(output_parts(name))
        with self._lock:
            self._files.hashed(name, self._pending[name], sha256)

    def temporary(self) -> Path:
        """A folder for temporary files, which goes when the run ends."""
        self._staging.mkdir(exist_ok=True)
        return self._staging

    def scratch(self) -> Scratch:
        """Somewhere else to write for a stage that is run again for what it makes, not for its outputs."""
        return Scratch(self._aside())

    def settle(self) -> None:
        """Wait until the disk has what was written, and remove what only an earlier run accounts for.

        `ResourceError` if the disk failed to take it, or a file can't be removed.
        """
        try:
            self._files.settle()
            for name in sorted(self.earlier):
                path = self.path / name
                remove(path)
                # folders that are empty now go as well
                for parent in path.parents:
                    if parent == self.path:
                        break
                    with contextlib.suppress(OSError):
                        parent.rmdir()
        except OSError as error:
            place = f" {error.filename!r}" if error.filename is not None else f" a file of {str(self.path)!r}"
            raise ResourceError(f"the disk failed to keep{place}: {error.strerror}", hint=DISK) from error
        self.earlier.clear()

    def write_sums(self, outputs: Collection[str]) -> dict[str, Any] | None:
        """List the digests of all files of these outputs in ``SHA256SUMS``, as ``sha256sum -c`` reads it."""
        text = self._files.sums(outputs)
        if not text:
            remove(self.path / SUMS)
            return None
        write_whole(self.path / SUMS, text)
        return {"path": SUMS, "bytes": len(text.encode()), "sha256": hashlib.sha256(text.encode()).hexdigest()}

    def add_file(self, name: str, text: str) -> dict[str, Any]:
        """Write a text file of the run's own; its path, size and digest."""
        write_whole(self.path / name, text)
        self.earlier.discard(name)
        return self._files.described(name, self.path / name)

    def discard(self) -> None:
        """Remove the staging area and let others use the directory."""
        self._files.close()
        clear(self._staging)
        self._folder_lock.release()
        clear(self._staging)  # with the descriptor of the lock, if there was no other

    def _aside(self) -> Path:
        """A name in the staging area that no output has."""
        # a counter, as several outputs may make way
        self._places += 1
        self._staging.mkdir(exist_ok=True)
        return self._staging / f"{STAGING}{self._places}"


class Scratch:
    """Takes the outputs of a stage that is run for what it makes, and throws them away."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._claims: set[str] = set()

    def claim(self, stage: str, name: str) -> Path:
        self._claims.add(name)
        staged = self._path.joinpath(*output_parts(name))
        staged.parent.mkdir(parents=True, exist_ok=True)
        return staged

    def restart(self, stage: str) -> None:
        self.discard()

    def pending(self) -> set[str]:
        """Names that were claimed and not discarded."""
        return set(self._claims)

    def scratch(self) -> Scratch:
        return Scratch(self._path)

    def discard(self) -> None:
        """Remove everything."""
        self._claims.clear()
        clear(self._path)


def is_run(path: Path) -> bool:
    """True if a folder is that of a run, or empty but for what a run had begun."""
    if not (path / RECORD).is_file():
        return all(child.name.startswith((STAGING, f".{RECORD}.")) or child.name == CLAIM for child in path.iterdir())
    with (path / RECORD).open("rb") as file:
        return f'"{RECORD_KEY}"'.encode() in file.read(200)


def remove_stale_runs(path: Path, current: Collection[str]) -> None:
    """Remove the runs of an earlier sweep that this one does not have, as far as their records account for them."""
    runs = path / SWEEP_RUNS
    for run in sorted(runs.glob("[0-9]*")) if runs.is_dir() else ():
        if run.name in current or run.is_symlink() or not (run / RECORD).is_file() or not is_run(run):
            continue
        folder = RunFolder(run)
        folder.prepare()
        try:
            folder.settle()
            for name in (RECORD, SUMS):
                remove(run / name)
            if not any(run.iterdir()):
                run.rmdir()
        finally:
            folder.discard()


def _recorded_outputs(path: Path) -> list[str]:
    """Names of the outputs that the record in a run directory accounts for and that lie inside of it."""
    try:
        record = json.loads((path / RECORD).read_bytes())
        outputs = [out.get("path") for stage in record.get("stages", ()) for out in stage.get("outputs", ())]
        outputs += record.get("earlier", ())
    except (OSError, ValueError, AttributeError, TypeError):
        outputs = []
    names = []
    for output in outputs:
        try:
            parts = output_parts(output)
        except (ConfigError, TypeError, AttributeError):
            continue  # another program's record; leave what it names
        if path.joinpath(*parts).parent.resolve().is_relative_to(path.resolve()):
            names.append("/".join(parts))
    return names


def _remove_unfinished(path: Path) -> None:
    """Remove staging areas and half-written records; the caller holds the lock, so that no other process uses them."""
    for name in (RECORD, SUMS, "sweep.csv", "sweep.csv-metadata.json", "sweep.json"):
        for half in path.glob(f".{name}.*"):
            half.unlink(missing_ok=True)
    for staging in path.glob(f"{STAGING}*"):
        clear(staging)


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
        self._syncing: list[tuple[Sequence[str], Future[None]]] = []
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
            self._syncing.append((part, self._workers().submit(_sync_all, part)))

    def changed(self, folders: Collection[Path]) -> None:
        """Remember folders in which names have changed."""
        self._folders |= {os.fspath(folder) for folder in folders}

    def settle(self) -> None:
        """Wait until the disk has all of them; `OSError` if it failed to take one."""
        # every job is waited for, so that none touches a file after an error was reported
        errors = [(part, error) for part, job in self._syncing if (error := job.exception()) is not None]
        self._syncing.clear()
        for part, error in errors:
            if getattr(error, "errno", None) not in (errno.EMFILE, errno.ENFILE):
                raise error
            _sync_all(part)  # what the stages had open is closed by now
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


def _parts(paths: Sequence[str]) -> list[Sequence[str]]:
    return [paths[first : first + _FILES_PER_TASK] for first in range(0, len(paths), _FILES_PER_TASK)]


def _sync_all(paths: Sequence[str]) -> None:
    for path in paths:
        sync(path)


def _digests(paths: Sequence[str]) -> list[tuple[str, int]]:
    return [file_digest(path) for path in paths]
