"""Where the cache lies, and how large it may be."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from sppm_pipeline.engine.cache.housekeeping import parse_size
from sppm_pipeline.engine.cache.store import CAP, Store
from sppm_pipeline.errors import ConfigError

FOLDER, SIZE = "SPPM_CACHE", "SPPM_CACHE_CAP"
"""Environment variables for the folder, or ``off``, and for the cap."""


def cache_folder(given: Path | None = None) -> Path | None:
    """The folder of the cache: `given`, else ``SPPM_CACHE``, else in the user's cache folder; None if turned off."""
    if given is not None:
        return given.absolute()
    if set_by := os.environ.get(FOLDER):
        return None if set_by.lower() == "off" else Path(set_by).absolute()
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA")
    else:
        home = os.environ.get("HOME")
        root = os.environ.get("XDG_CACHE_HOME") or (os.path.join(home, ".cache") if home else None)
    if root:
        return Path(root).absolute() / "sppm" / "results"
    user = getattr(os, "getuid", lambda: "user")()
    return Path(tempfile.gettempdir()) / f"sppm-results-{user}"


def cache_cap() -> int:
    """Bytes that the cache may take.

    Raises
    ------
    ConfigError
        If ``SPPM_CACHE_CAP`` is no size.
    """
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
