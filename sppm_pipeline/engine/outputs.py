"""The run directory: files appear in it whole or not at all, and never outside it."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import threading
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.document import RECORD_KEY
from sppm_pipeline.engine.names import STAGING as _STAGING
from sppm_pipeline.engine.names import collide, folded, output_parts
from sppm_pipeline.errors import ConfigError, PluginError, ResourceError

__all__ = ["RECORD", "SWEEP_RUNS", "RunFolder", "digest_of", "output_parts", "write_whole"]

RECORD = "run.json"
SWEEP_RUNS = "runs"

DIGEST_LIMIT = 1 << 28
"""Outputs larger than this many bytes get no digest: hashing would take longer than writing."""


class RunFolder:
    """A run directory with its staging area.

    Parameters
    ----------
    path : Path
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._staging = path / f"{_STAGING}{os.getpid()}"
        self._claims: dict[tuple[str, ...], tuple[str, str]] = {}
        self._pending: dict[str, Path] = {}
        self._lock = threading.Lock()

    def prepare(self) -> None:
        """Make the directory, or empty it of what an earlier run left.

        Raises
        ------
        ConfigError
            If it holds something that is not from a run.
        ResourceError
            If it can't be written.
        """
        try:
            if self.path.exists() and not self.path.is_dir():
                raise ConfigError(f"{str(self.path)!r} is a file, not a run directory", hint="choose another with -o")
            if self.path.is_dir() and any(self.path.iterdir()):
                if not _is_run(self.path):
                    raise ConfigError(
                        f"the folder {str(self.path)!r} is not empty and holds no earlier run",
                        hint="choose another with -o; nothing of yours is overwritten",
                    )
                _clear(self.path)
            self.path.mkdir(parents=True, exist_ok=True)
            if not os.access(self.path, os.W_OK | os.X_OK):
                raise PermissionError(13, "Permission denied")
        except OSError as error:
            raise ResourceError(f"can't use the run directory {str(self.path)!r}: {error.strerror}") from error

    def claim(self, stage: str, name: str) -> Path:
        """A path in the staging area for the output `name` of a stage; see `Context.output`."""
        parts = output_parts(name)
        key = folded(parts)
        with self._lock:
            for other, (owner, other_name) in self._claims.items():
                if collide(other, key) and (owner != stage or other != key):
                    raise ConfigError(
                        f"the output {name!r} collides with {other_name!r} of stage {owner!r}",
                        hint="give one of them another path",
                    )
            final = self.path.joinpath(*parts)
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
                    _remove(self._pending.pop(name))

    def commit(self) -> list[dict[str, Any]]:
        """Move what was staged into place; paths, sizes and digests.

        Raises
        ------
        PluginError
            If a stage asked for an output and did not write it.
        ResourceError
            If it can't be moved.
        """
        with self._lock:
            pending, self._pending = self._pending, {}
        for name, staged in pending.items():
            if not staged.exists():
                raise PluginError(f"the output {name!r} was announced but not written")
        outputs = []
        try:
            for name, staged in pending.items():
                final = self.path / name
                final.parent.mkdir(parents=True, exist_ok=True)
                if final.is_dir() and not final.is_symlink():
                    shutil.rmtree(final)
                os.replace(staged, final)
                outputs.append({"path": name, **_described(final)})
        except OSError as error:
            raise ResourceError(f"can't put the output {name!r} into place: {error.strerror}") from error
        return outputs

    def discard(self) -> None:
        """Remove the staging area."""
        shutil.rmtree(self._staging, ignore_errors=True)


def _is_run(path: Path) -> bool:
    if not (path / RECORD).is_file():
        return all(child.name.startswith(_STAGING) for child in path.iterdir())
    with (path / RECORD).open("rb") as file:
        return f'"{RECORD_KEY}"'.encode() in file.read(200)


def _clear(path: Path) -> None:
    """Remove what the record of an earlier run lists; files it does not know stay."""
    try:
        record = json.loads((path / RECORD).read_bytes())
        outputs = [out for stage in record.get("stages", ()) for out in stage.get("outputs", ())]
    except (OSError, ValueError, AttributeError, TypeError):
        outputs = []
    for output in outputs:
        try:
            parts = output_parts(output["path"])
        except (ConfigError, KeyError, TypeError, AttributeError):
            continue  # not a record of ours; leave what it names
        if path.joinpath(*parts).parent.resolve().is_relative_to(path.resolve()):
            _remove(path.joinpath(*parts))
    for run in sorted((path / SWEEP_RUNS).glob("[0-9]*")) if (path / SWEEP_RUNS).is_dir() else ():
        if run.is_dir() and not run.is_symlink() and (run / RECORD).is_file() and _is_run(run):
            _clear(run)
            (run / RECORD).unlink()
            if not any(run.iterdir()):
                run.rmdir()
    for name in ("sweep.csv", "sweep.json"):
        (path / name).unlink(missing_ok=True)
    for staging in path.glob(f"{_STAGING}*"):
        if not _alive(staging.name.removeprefix(_STAGING)):
            shutil.rmtree(staging, ignore_errors=True)


def _alive(pid: str) -> bool:
    if not pid.isdigit():
        return False
    try:
        os.kill(int(pid), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return int(pid) != os.getpid()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _described(path: Path) -> dict[str, Any]:
    """Size, number of files and digest of a finished output."""
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    size = sum(file.stat().st_size for file in files)
    described: dict[str, Any] = {"bytes": size}
    if path.is_dir():
        described["files"] = len(files)
    described["sha256"] = digest_of(path) if size <= DIGEST_LIMIT else None
    return described


def digest_of(path: Path) -> str:
    """SHA-256 of a file; of a folder, over the names and digests of its files in order of their names."""
    if not path.is_dir():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    total = hashlib.sha256()
    names = sorted(p.relative_to(path).as_posix() for p in path.rglob("*") if p.is_file())
    for name in names:
        total.update(f"{name}\0{digest_of(path / name)}\n".encode())
    return total.hexdigest()


def write_whole(path: Path, text: str, *, durable: bool = True) -> None:
    """Write a text file so that it is there whole or not at all; if `durable`, even if the machine stops.

    Raises
    ------
    ResourceError
        If the disk is full or a permission is missing.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with temporary.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise ResourceError(f"can't write {str(path)!r}: {error.strerror}") from error
