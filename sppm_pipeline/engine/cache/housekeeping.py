"""Location, contents, soundness and size limit of a cache."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.cache.store import CAP, Store
from sppm_pipeline.engine.locks import FolderLock
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.storage import DamagedError
from sppm_pipeline.services.private_folder import exposure, make_private, temporary_folder

AFTER_PRUNING = 0.8
"""Share of the cap that is left after entries were removed, so that not every run has to remove some."""

MAX_RECENTS = 2000
"""Configurations whose last run is remembered."""


def parse_size(text: str, thousand: int = 1000) -> int:
    """Bytes from ``5GB``, ``800 MB``, ``2GiB`` or a bare number, with powers of `thousand` for units without an i;
    else `ValueError`.
    """
    found = re.fullmatch(r"(\d{1,19}(?:\.\d{1,9})?)\s*([kmgt]?)(i?)b?", text.strip().lower())
    size = float(found[1]) * (1024 if found[3] else thousand) ** ("kmgt".find(found[2] or "-") + 1) if found else -1
    if found is None or (found[3] and not found[2]) or not 0 <= size < 2**63:
        raise ValueError(f"expected a size such as 800M or 2G, got {text[:40]!r}")
    return int(size)


@dataclass(frozen=True)
class Occupancy:
    """One entry as `contents` finds it; `used` is the time of its last use in seconds since 1970."""

    key: str
    bytes: int
    used: float


def contents(store: Store) -> list[Occupancy]:
    """All entries, least recently used first, with the space they take on disk."""
    found = []
    for key in store.entries():
        folder = store.place(key)
        with contextlib.suppress(OSError):
            used, size = folder.stat().st_mtime, 0
            with os.scandir(folder) as files:
                for file in files:
                    about = file.stat(follow_symlinks=False)
                    # small files take whole blocks; st_blocks counts 512 bytes on every system
                    size += max(about.st_size, getattr(about, "st_blocks", 0) * 512)
                    if file.name == "manifest.json":
                        used = about.st_mtime
            found.append(Occupancy(key, size, used))
    # the key, so that entries of equal time go in the same order everywhere
    return sorted(found, key=lambda entry: (entry.used, entry.key))


def prune(store: Store, cap: int) -> tuple[int, int]:
    """Remove the entries that were not used for longest until at most `cap` bytes are left.

    Returns the number of entries removed and the bytes that are left.
    """
    store.clear_leftovers()
    entries = contents(store)
    total = sum(entry.bytes for entry in entries)
    removed = 0
    for entry in entries:
        if total <= cap:
            break
        store.remove(entry.key)
        total -= entry.bytes
        removed += 1
    with contextlib.suppress(OSError):
        recents = sorted((store.root / "recent").iterdir(), key=lambda path: path.stat().st_mtime, reverse=True)
        # a cap of 0 empties the cache
        for path in recents[MAX_RECENTS:] if cap else recents:
            path.unlink(missing_ok=True)
    if store.root.is_dir():
        _set_usage(store.root, total)
    return removed, total


def account(store: Store) -> int:
    """Add what `store` has written to the cache's account, and prune if it is over its cap; entries removed."""
    if not store.written:
        return 0
    cap = store.cap
    # an account instead of a count: a large cache takes long to look through
    total = _add_usage(store.root, store.written)
    store.written = 0
    if total is not None and total <= cap:
        return 0
    removed = prune(store, int(cap * AFTER_PRUNING)) if sum(e.bytes for e in contents(store)) > cap else (0, 0)
    if not removed[0]:
        _set_usage(store.root, sum(entry.bytes for entry in contents(store)))
    return removed[0]


def damaged_entries(store: Store) -> list[tuple[str, str]]:
    """Read every byte of a cache; keys of entries that are not sound, and why. They are removed."""
    damaged = []
    for key in list(store.entries()):
        try:
            entry = store.find(key, touch=False)
            if entry is None:
                if store.place(key).is_dir():
                    raise DamagedError("it has no manifest")
                continue
            for name, file in entry.files().items():
                path = entry.folder / name
                with path.open("rb") as opened:
                    digest = hashlib.file_digest(opened, "sha256").hexdigest()
                if digest != file.sha256:
                    raise DamagedError(f"{name}: its SHA-256 differs")
        except (DamagedError, FileNotFoundError) as error:
            if store.place(key).exists() or isinstance(error, DamagedError):
                damaged.append((key, str(error)))
                store.remove(key)
    return damaged


def _add_usage(root: Path, written: int) -> int | None:
    """The account after adding to it; None if it has not been counted yet."""
    before = _change_usage(root, lambda old: None if old is None else old + written)
    return None if before is None else before + written


def _set_usage(root: Path, total: int) -> None:
    _change_usage(root, lambda old: total)


def _change_usage(root: Path, change: Any) -> int | None:
    """Change the number in the account; what it was. The file is there for good, and locked while it is changed."""
    path = root / "usage"
    try:
        with path.open("a+") as file:
            lock = FolderLock(path)
            lock.acquire(wait=True)
            try:
                file.seek(0)
                text = file.read().strip()
                old = int(text) if text.isdigit() else None
                new = change(old)
                if new is not None:
                    file.seek(0)
                    file.truncate()
                    file.write(str(new))
                    file.flush()
                return old
            finally:
                lock.release()
    except OSError:
        return None


FOLDER, SIZE = "SPPM_CACHE", "SPPM_CACHE_CAP"
"""Environment variables for the folder, or ``off``, and for the cap."""


def cache_folder(given: Path | None = None) -> Path | None:
    """The folder of the cache: `given`, else ``SPPM_CACHE``, else in the user's cache folder; None if turned off.

    `ConfigError` if another user may have written to the folder that was named.
    """
    if given is not None:
        return _vouched(given.absolute(), "--cache")
    if set_by := os.environ.get(FOLDER):
        return None if set_by.lower() == "off" else _vouched(Path(set_by).absolute(), FOLDER)
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA")
    else:
        home = os.environ.get("HOME")
        root = os.environ.get("XDG_CACHE_HOME") or (os.path.join(home, ".cache") if home else None)
    user = getattr(os, "getuid", lambda: "user")()
    if root:
        place = Path(root).absolute() / "sppm" / "results"
        # another user's entries would be loaded as our own results
        if not place.exists() or not exposure(place):
            return place
    shared = Path(tempfile.gettempdir()) / f"sppm-results-{user}"
    with contextlib.suppress(OSError):
        make_private(shared)  # first, so that no other user makes it between the look and its use
        if not exposure(shared):
            return shared
    return _own_folder()


@functools.cache
def _own_folder() -> Path:
    return temporary_folder("sppm-results-")


def _vouched(folder: Path, by: str) -> Path:
    if folder.exists() and (why := exposure(folder.resolve())):
        raise ConfigError(
            f"the cache {str(folder)!r} can't be trusted: {why}",
            hint=f"name one of yours with {by}, for instance {str(folder / 'mine')!r}, or chmod go-w it if it is yours",
        )
    return folder


def cache_cap() -> int:
    """Bytes that the cache may take; `ConfigError` if ``SPPM_CACHE_CAP`` is no size."""
    text = os.environ.get(SIZE)
    if not text:
        return CAP
    try:
        return parse_size(text)
    except ValueError as error:
        raise ConfigError(f"{SIZE}: {error}") from None


def open_store(folder: Path) -> Store:
    """The cache in a folder, with the cap that the environment asks for."""
    return Store(folder, cache_cap())
