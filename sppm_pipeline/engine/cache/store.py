"""Entries of the cache on disk.

::

    <root>/entries/<first two digits>/<key>/manifest.json   what is there, sealed with its digest
                                            *.npy, value.json, outputs.bin
    <root>/recent/<digest>.json             what the keys of a configuration's last run were made of
    <root>/tmp/<random>/                    entries being written; locked by the process that writes them
    <root>/usage                            bytes written since all was counted last

An entry is written elsewhere and renamed into place in one step, its manifest last; one without a sound manifest does
not exist. Processes share a cache without waiting for each other: of several that make the same entry, the first one
to be ready puts it there, and others add what it lacks. A reader that finds an entry damaged removes it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import secrets
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.locks import FolderLock
from sppm_pipeline.engine.strict_json import BrokenSealError, json_text, read_sealed, sealed
from sppm_pipeline.nouns.storage import DamagedError, StoredFile, load_value, save_value

FORMAT = 1

CAP = 5 * 10**9
"""Default limit of the size of a cache, bytes."""

MANIFEST = "manifest.json"
OUTPUTS = "outputs.bin"
_TAG = "Signature: 8a477f597d28d172789f06886806bc55\n# Results of sppm; may be deleted at any time.\n"
_CHUNK = 1 << 20


@dataclass(frozen=True)
class Entry:
    """One kept result."""

    key: str
    folder: Path
    manifest: Mapping[str, Any]  # `facts`, `ingredients`, `seconds` and what is stored; see `Store.put`

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts of the stage for the run record."""
        facts: Mapping[str, Any] = self.manifest["facts"]
        return facts

    @property
    def has_value(self) -> bool:
        """True if the artifact that the stage made can be loaded."""
        return self.manifest.get("value") is not None

    @property
    def has_outputs(self) -> bool:
        """True if the files that the stage wrote can be written again."""
        return self.manifest.get("outputs") is not None

    def files(self) -> dict[str, StoredFile]:
        """All files of the entry but the manifest."""
        listed = [
            *(self.manifest.get("value") or []),
            *([self.manifest["outputs"]["file"]] if self.has_outputs else []),
        ]
        return {name: StoredFile(name, size, digest) for name, size, digest in listed}


class Store:
    """A cache folder, which need not exist, of at most `cap` bytes; more is removed after a run, what was not used for
    longest first.
    """

    def __init__(self, root: Path, cap: int = CAP) -> None:
        self.root = root
        self.cap = cap
        self.written = 0
        """Bytes written by this object."""
        self._staging: Path | None = None
        self._lock: FolderLock | None = None

    # --- reading ---

    def place(self, key: str) -> Path:
        """Folder of the entry of a key, if there is one."""
        return self.root / "entries" / key[:2] / key

    def find(self, key: str, *, touch: bool = True) -> Entry | None:
        """The entry of a key, or None; a damaged one is removed, and raises `DamagedError`."""
        folder = self.place(key)
        try:
            data = (folder / MANIFEST).read_bytes()
        except OSError:
            return None
        try:
            manifest = read_sealed(data)
            if manifest["format"] != FORMAT or manifest["key"] != key:
                raise BrokenSealError("it is another entry's")
        except (BrokenSealError, ValueError, KeyError, TypeError) as error:
            self.remove(key)
            raise DamagedError(f"{folder / MANIFEST}: {error}") from error
        if touch:
            with contextlib.suppress(OSError):
                # its time is that of the last use, by which entries are removed
                os.utime(folder / MANIFEST)
        return Entry(key, folder, manifest)

    def load(self, entry: Entry) -> Any:
        """The artifact of an entry; `DamagedError` if a byte of it has changed, `OSError` if it is gone."""
        return load_value(entry.folder, entry.files())

    def restore(self, entry: Entry, claim: Callable[[str], Path]) -> None:
        """Write the outputs of an entry again, each to the path that `claim` gives for its name; raises as `load`."""
        outputs = entry.manifest["outputs"]
        staged = {name: claim(name) for name in outputs["names"]}
        for name in outputs["folders"]:
            staged[name].mkdir(parents=True, exist_ok=True)
        with (entry.folder / OUTPUTS).open("rb") as source:
            for name, inside, size, digest in outputs["content"]:
                path = staged[name] / inside if inside else staged[name]
                path.parent.mkdir(parents=True, exist_ok=True)
                found = hashlib.sha256()
                with path.open("wb") as target:
                    for chunk in _chunks(source.read, size):
                        found.update(chunk)
                        target.write(chunk)
                if found.hexdigest() != digest:
                    raise DamagedError(f"{entry.folder / OUTPUTS} is damaged: the SHA-256 of {name!r} differs")

    # --- writing ---

    def put(
        self,
        key: str,
        manifest: Mapping[str, Any],
        *,
        value: Any = None,
        outputs: Sequence[tuple[str, Path]] = (),
        durable: bool = False,
    ) -> None:
        """Keep a result, with outputs as (name, path); an entry that the key has already gets what it lacks.

        `key`, `format`, `value` and `outputs` are added to the JSON-ready manifest. `durable` waits for the disk;
        without it an entry that a power cut damages is noticed by its digests. Raises `OSError` if there is no space or
        permission, `NotStorable` if the value can't be written.
        """
        fresh = self._staging_folder() / secrets.token_hex(8)
        fresh.mkdir()
        try:
            whole = {"format": FORMAT, "key": key, **manifest, "value": None, "outputs": None}
            if value is not None:
                whole["value"] = [list(file) for file in save_value(value, fresh, durable=durable)]
            if outputs:
                whole["outputs"] = _pack(fresh / OUTPUTS, outputs, durable)
            _write_manifest(fresh, whole, durable)
            size = sum(file.stat().st_size for file in fresh.iterdir())
            self._put_into_place(key, fresh, durable)
            self.written += size
        finally:
            shutil.rmtree(fresh, ignore_errors=True)

    def _put_into_place(self, key: str, fresh: Path, durable: bool) -> None:
        place = self.place(key)
        place.parent.mkdir(parents=True, exist_ok=True)
        # other processes may put the same entry there between two steps; a few tries outlast them
        for _ in range(8):
            try:
                os.rename(fresh, place)
                return
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                    raise
            try:
                there = self.find(key, touch=False)
            except DamagedError:
                continue
            if there is None:
                self.remove(key)
                continue
            # one may hold the artifact and the other the files, depending on what a run could afford
            mine = Entry(key, fresh, read_sealed((fresh / MANIFEST).read_bytes()))
            lacking = {
                kind: mine.manifest[kind]
                for kind in ("value", "outputs")
                if there.manifest[kind] is None and mine.manifest[kind] is not None
            }
            if not lacking:
                return
            # its files first, which no manifest names yet, then one that names all: nothing is lost wherever this ends
            for name in Entry(key, fresh, {"value": None, "outputs": None, **lacking}).files():
                os.replace(fresh / name, place / name)
            _write_manifest(fresh, {**there.manifest, **lacking}, durable)
            os.replace(fresh / MANIFEST, place / MANIFEST)
            return

    def remove(self, key: str) -> None:
        """Take an entry away, in one step, so that no reader sees half of it."""
        with contextlib.suppress(OSError):
            gone = self._staging_folder() / secrets.token_hex(8)
            os.rename(self.place(key), gone)
            shutil.rmtree(gone, ignore_errors=True)

    def write_text(self, name: str, value: Mapping[str, Any]) -> None:
        """Write a sealed JSON file of the cache, whole or not at all."""
        fresh = self._staging_folder() / secrets.token_hex(8)
        fresh.write_bytes(json_text(sealed(value)).encode())
        final = self.root / name
        final.parent.mkdir(parents=True, exist_ok=True)
        # in one step, so that a reader finds the old text or the new one
        os.replace(fresh, final)

    def read_text(self, name: str) -> dict[str, Any] | None:
        """Read what `write_text` wrote; None if it is not there or not sound."""
        try:
            return read_sealed((self.root / name).read_bytes())
        except (OSError, ValueError):
            return None

    # --- staging of what is not ready yet ---

    def _staging_folder(self) -> Path:
        """This object's folder for unfinished entries; its lock shows others that it is in use."""
        if self._staging is None or not self._staging.is_dir():
            if not self.root.is_dir():
                self.root.mkdir(parents=True, exist_ok=True, mode=0o700)
                (self.root / "CACHEDIR.TAG").write_text(_TAG, encoding="utf-8")
            while True:
                staging = self.root / "tmp" / secrets.token_hex(8)
                staging.mkdir(parents=True)
                lock = FolderLock(staging)
                try:
                    if lock.acquire():
                        break
                except FileNotFoundError:  # another process has removed it in between
                    continue
            self._staging, self._lock = staging, lock
        return self._staging

    def clear_leftovers(self) -> int:
        """Remove what processes that are gone left unfinished; how much that was."""
        removed = 0
        with contextlib.suppress(OSError):
            for staging in (self.root / "tmp").iterdir():
                if staging == self._staging:
                    continue
                lock = FolderLock(staging)
                with contextlib.suppress(OSError):
                    if lock.acquire():
                        shutil.rmtree(staging, ignore_errors=True)
                        removed += 1
                lock.release()
        return removed

    def close(self) -> None:
        """Remove the staging folder."""
        if self._staging is not None and self._lock is not None:
            shutil.rmtree(self._staging, ignore_errors=True)
            self._lock.release()
            self._staging = self._lock = None

    def entries(self) -> Iterator[str]:
        """Keys of all entries."""
        with contextlib.suppress(FileNotFoundError):
            for group in sorted(os.listdir(self.root / "entries")):
                with contextlib.suppress(OSError):
                    yield from sorted(os.listdir(self.root / "entries" / group))


def _write_manifest(folder: Path, manifest: Mapping[str, Any], durable: bool) -> None:
    with (folder / MANIFEST).open("wb") as file:
        file.write(json_text(sealed(manifest)).encode())
        if durable:
            file.flush()
            os.fsync(file.fileno())


def _pack(path: Path, outputs: Sequence[tuple[str, Path]], durable: bool) -> dict[str, Any]:
    """Write files one behind the other, and say which is where."""
    content: list[list[Any]] = []
    folders = []
    total = hashlib.sha256()
    size = 0
    with path.open("xb") as target:
        for name, output in outputs:
            inside = [""]
            if output.is_dir():
                folders.append(name)
                # sorted: equal outputs have equal bytes on every file system
                inside = sorted(p.relative_to(output).as_posix() for p in output.rglob("*") if p.is_file())
            for relative in inside:
                own, length = hashlib.sha256(), 0
                with (output / relative if relative else output).open("rb") as source:
                    while chunk := source.read(_CHUNK):
                        own.update(chunk)
                        total.update(chunk)
                        target.write(chunk)
                        length += len(chunk)
                content.append([name, relative, length, own.hexdigest()])
                size += length
        if durable:
            target.flush()
            os.fsync(target.fileno())
    return {
        "file": [OUTPUTS, size, total.hexdigest()],
        "names": [name for name, _ in outputs],
        "folders": folders,
        "content": content,
    }


def _chunks(read: Callable[[int], bytes], size: int) -> Iterator[bytes]:
    """Exactly `size` bytes, piece by piece."""
    while size:
        chunk = read(min(size, _CHUNK))
        if not chunk:
            raise DamagedError(f"{OUTPUTS} is cut short")
        size -= len(chunk)
        yield chunk
