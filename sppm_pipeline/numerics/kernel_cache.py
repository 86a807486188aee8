"""Where compiled kernels are kept between runs, and a notice when one is not there.

Numba keys a kept kernel by its own source file alone, so a kernel that inlines one from another file, or a constant,
would be reused after that file has changed. Therefore each module has folders of its own, one for each state of the
module and of everything it imports from its package: another version of the program, or an edit, starts a folder for
the modules it reaches and for no others. Free of Numba, so that asking costs nothing.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

KEPT_STATES = 4
"""Folders of earlier states of a module that stay, newest first; users may have several environments."""

_IMPORT = re.compile(rb"^\s*from\s+([\w.]+)\s+import\s+(\([^)]*\)|[^\n#]*)", re.MULTILINE)


def kernel_cache_folder(source: str) -> Path:
    """A writable folder for the kernels of one module, in exactly this state of it and of what it imports.

    Parameters
    ----------
    source : str
        File of the module.
    """
    folder = kernel_cache_root() / Path(source).stem / _state(source)
    try:
        if not folder.is_dir():
            folder.mkdir(parents=True, exist_ok=True)
            _prune(folder.parent, folder)
    except OSError:
        return Path(tempfile.mkdtemp(prefix="sppm-kernels-"))
    return folder


@functools.cache
def kernel_cache_root() -> Path:
    """The writable folder that holds those of all modules.

    It lies under ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache folder, else in the temporary folder.
    """
    for base in _bases():
        try:
            base.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(base, os.W_OK | os.X_OK):
            return base
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


@functools.cache
def _state(source: str) -> str:
    """Digest of the interpreter, the module and all modules that it imports, directly or not, from its package."""
    h = hashlib.sha256(f"{sys.version_info[:3]}{sys.prefix}".encode())
    reached, waiting = set(), [os.path.abspath(source)]
    while waiting:
        file = waiting.pop()
        if file not in reached:
            reached.add(file)
            waiting += _read(file)[1]
    for file in sorted(reached):
        h.update(f"{os.path.basename(file)}:{_read(file)[0]};".encode())
    return h.hexdigest()[:16]


@functools.cache
def _read(file: str) -> tuple[str, tuple[str, ...]]:
    """Digest of a source file, and the files of those modules of its own package that it imports."""
    with open(file, "rb") as opened:
        text = opened.read()
    package, top = os.path.dirname(file), ""
    while os.path.isfile(os.path.join(package, "__init__.py")):
        package, top = os.path.split(package)
    found = []
    for module, names in _IMPORT.findall(text):
        parts = module.decode().split(".")
        if parts[0] != top:
            continue
        # what is imported may be a name in a module, or a module in a folder
        for path in (parts, *([*parts, name] for name in re.findall(r"\w+", names.decode()))):
            place = os.path.join(package, *path) + ".py"
            if os.path.isfile(place):
                found.append(place)
    return hashlib.sha256(text).hexdigest(), tuple(found)


def _prune(base: Path, current: Path) -> None:
    """Remove the oldest states of a module."""
    others = [f for f in base.iterdir() if f.is_dir() and f != current]
    others.sort(key=lambda f: f.stat().st_mtime, reverse=True)
    for old in others[KEPT_STATES:]:
        shutil.rmtree(old, ignore_errors=True)


def kernel_cache_lasts() -> bool:
    """Whether another process finds what is kept."""
    return kernel_cache_root() in _bases()


def is_kept(place: str, specializations: int) -> bool:
    """Whether a kernel was compiled for so many kinds of arguments, without loading it.

    Parameters
    ----------
    place : str
        ``package.module:name``, of a module of this package.
    specializations : int
    """
    module, _, name = place.partition(":")
    source = str(Path(__file__).parents[2].joinpath(*module.split("."))) + ".py"
    kept = _kept_files(kernel_cache_folder(source))
    stem = f"{module.rpartition('.')[2]}.{name}-"
    return sum(file.startswith(stem) and file.endswith(".nbc") for file in kept) >= specializations


def look_again() -> None:
    """Forget which kernels were kept when `is_kept` last looked: other processes may have compiled some since."""
    _kept_files.cache_clear()


@functools.cache
def _kept_files(folder: Path) -> tuple[str, ...]:
    return tuple(file.name for file in folder.glob("*/*.nbc"))


@contextlib.contextmanager
def saving(folder: str | Path) -> Iterator[None]:
    """Let one process at a time save into a folder of kernels, where the system has locks.

    Numba reads the list of what is kept of a kernel, adds a file and writes the list anew: two that do so at the same
    time for unlike arguments would write one file, and one of them would later be given the code of the other.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError):  # Windows; a file system without locks
            import fcntl

            lock = os.open(os.path.join(folder, "lock"), os.O_RDWR | os.O_CREAT, 0o600)
            stack.callback(os.close, lock)
            fcntl.flock(lock, fcntl.LOCK_EX)
        yield


waiting: list[Callable[[], None]] = []
"""Callbacks that have not been called."""


def on_first_compilation(callback: Callable[[], None]) -> None:
    """Call `callback` once, at the moment when a kernel is not found in the cache and has to be compiled."""
    waiting.append(callback)


def first_compilation() -> None:
    """Call what waits; `sppm_pipeline.numerics.compiled` does so when Numba starts to compile."""
    while waiting:
        waiting.pop(0)()
