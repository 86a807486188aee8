"""Where compiled kernels are kept between runs.

Numba keys a kept kernel by its own source file alone, so a kernel that inlines one from another file would be reused
after that file has changed. Therefore the folder is named after the state of all source files: another version of the
program, or an edit, starts a folder of its own. Free of Numba, so that asking costs nothing.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import tempfile
from pathlib import Path

__all__ = ["kernel_cache_folder"]

KEPT_STATES = 4
"""Folders of earlier states that stay, newest first; users may have several environments."""


def kernel_cache_folder() -> Path:
    """A writable folder for kernels of exactly these sources.

    It lies under ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache folder, else in the temporary folder.
    """
    state = _state_of_sources()
    for base in _bases():
        folder = base / state
        try:
            new = not folder.exists()
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                continue
            if new:
                _prune(base, folder)
        except OSError:
            continue
        return folder
    return Path(tempfile.mkdtemp(prefix="sppm-kernels-"))


def _bases() -> list[Path]:
    bases = []
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        bases.append(Path(given) / "sppm-kernels")
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA")
    else:
        root = os.environ.get("XDG_CACHE_HOME") or (os.path.expanduser("~/.cache") if os.environ.get("HOME") else None)
    if root:
        bases.append(Path(root) / "sppm" / "kernels")
    user = getattr(os, "getuid", lambda: "user")()
    bases.append(Path(tempfile.gettempdir()) / f"sppm-kernels-{user}")
    return bases


def _state_of_sources() -> str:
    """Digest of names, sizes and times of change of all files that hold kernels, and of the interpreter."""
    h = hashlib.sha256(f"{sys.version_info[:3]}{sys.prefix}".encode())
    package = Path(__file__).parent.parent
    for room in ("numerics", "formats"):
        for folder, _, names in sorted(os.walk(package / room)):
            for name in sorted(names):
                if name.endswith(".py"):
                    status = os.stat(os.path.join(folder, name))
                    h.update(f"{folder}/{name}:{status.st_size}:{status.st_mtime_ns};".encode())
    return h.hexdigest()[:20]


def _prune(base: Path, current: Path) -> None:
    """Remove the oldest states."""
    others = [f for f in base.iterdir() if f.is_dir() and f != current]
    others.sort(key=lambda f: f.stat().st_mtime, reverse=True)
    for old in others[KEPT_STATES:]:
        shutil.rmtree(old, ignore_errors=True)
