"""Folders in which compiled kernels are kept between runs, and a notice when one is missing.

Numba keys a kept kernel by its own source file alone, so a kernel that inlines one from another file, or a constant,
would be reused after that file has changed. Therefore each module has folders of its own, one for each state of the
module and of everything it imports from its package: another version of the program, or an edit, starts a folder for
the modules it reaches and for no others. Free of Numba, so that asking costs nothing.

Modules of plugins may inline what other packages supply. Sources of these are followed as well, those of installed
packages as far as they name Numba or this program, beside the version of their distribution. Of this program, all
numerics count: what a plugin takes from the public face is found when it is used.
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

from sppm_pipeline.services.private_folder import exposure, make_private, temporary_folder

KEPT_STATES = 4
"""Folders of earlier states of a module that stay, newest first; users may have several environments."""

_IMPORT = re.compile(rb"^\s*from\s+(\.*)([\w.]*)\s*import\b\s*(\([^)]*\)|[^\n#]*)", re.MULTILINE)
_PLAIN_IMPORT = re.compile(rb"^\s*import\s+([^\n#;]*)", re.MULTILINE)

_PROGRAM = "sppm_pipeline"
_KERNELS = re.compile(rb"numba|" + _PROGRAM.encode())
_CONTINUED = re.compile(rb"\\\r?\n")
_NOT_FOLLOWED = sys.stdlib_module_names | {"numpy", "numba", "llvmlite", "scipy"}
"""Packages without kernels, or whose versions Numba and `machine_code` ask for."""


def kernel_cache_folder(source: str) -> Path:
    """A writable folder for the kernels of one module file, in exactly this state of it and of what it imports."""
    # of environments that share it, each has its own: Numba compares times of files
    state = hashlib.sha256(f"{sys.version}{sys.prefix}{_state(source)}".encode()).hexdigest()[:16]
    place = Path(Path(source).stem, state)
    folder = kernel_cache_root() / place
    if folder.is_dir():
        return folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        folder = _temporary() / place
        folder.mkdir(parents=True, exist_ok=True)
        return folder
    with contextlib.suppress(OSError):  # another process may remove the same
        _prune(folder.parent, folder)
    return folder


@functools.cache
def _temporary() -> Path:
    """A folder for the kernels of this process alone, which goes when it ends."""
    return temporary_folder("sppm-kernels-")


@functools.cache
def kernel_cache_root() -> Path:
    """The writable folder that holds those of all modules.

    It lies under ``NUMBA_CACHE_DIR`` if that is set, else in the user's cache folder, else in the temporary folder.
    What lies there is run as machine code, so a folder that another user can write to is passed over; see `exposure`.
    """
    return next((base for base in _bases() if not unusable(base)), None) or _temporary()


def unusable(base: Path) -> str:
    """Reason why a folder can't hold kernels; empty if it can. It is made if it is missing."""
    try:
        make_private(base)
    except OSError as error:
        return f"it can't be made: {error.strerror}"
    if not os.access(base, os.W_OK | os.X_OK):
        return "it can't be written"
    return exposure(base)


def installed_folder(package: str) -> tuple[str, str]:
    """The folder of an installed package, without its import, and the reason why others may have written to it."""
    from importlib.util import find_spec

    found = find_spec(package)
    folder = next(iter((found and found.submodule_search_locations) or ()), "")
    return folder, exposure(Path(folder)) if folder else ""


def passed_over() -> dict[str, str]:
    """Folders for kernels that come before the one that is used, and why each is not."""
    reasons = {}
    for base in _bases():
        if base == kernel_cache_root():
            break
        reasons[str(base)] = unusable(base)
    return reasons


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


def state_of(source: str) -> str:
    """Key of the state of a module file and of all that it imports; empty if it can't be read."""
    try:
        return _state(source)
    except OSError:
        return ""


@functools.cache
def _state(source: str) -> str:
    """Digest of a module and all modules that it imports, directly or not."""
    h = hashlib.sha256()
    first = os.path.abspath(source)
    place = _package_of(os.path.dirname(first))
    reached, waiting = {first: _read(first, place)}, [first]
    marks: set[str] = set()
    while waiting:
        _, files, others = reached[waiting.pop()]
        marks.update(others)
        for file in files:
            if file not in reached:
                with contextlib.suppress(OSError):  # what can't be read can't be imported
                    reached[file] = _read(file, place)
                    waiting.append(file)
    for file in sorted(reached):
        h.update(f"{os.path.basename(file)}:{reached[file][0]};".encode())
    for mark in sorted(marks):
        h.update(f"{mark};".encode())
    return h.hexdigest()[:16]


@functools.cache
def _read(file: str, place: tuple[str, str] | None = None) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Digest of a source file, the files of modules that it imports, and what else its state depends on.

    `place` is the package that is asked for; of others that are installed, few files are followed.
    """
    with open(file, "rb") as opened:
        text = opened.read()
    digest = hashlib.sha256(text).hexdigest()
    folder = os.path.dirname(file)
    root, top = _package_of(folder)
    if top != _PROGRAM and (root, top) != place and _installed(root) and not _KERNELS.search(text):
        return digest, (), ()
    text = _CONTINUED.sub(b" ", text)
    found: list[str] = []
    if top == _PROGRAM:
        # here `import x` says that a module is no part of the state, and the files of packages hold no kernels
        for dots, module, names in _IMPORT.findall(text):
            parts = module.decode().split(".")
            if not dots and parts[0] == top:
                found += [f for f in _modules(root, parts, _words(names)) if not f.endswith("__init__.py")]
        return digest, tuple(found), ()
    marks: set[str] = set()
    for dots, parts, wanted in _imports(text):
        if dots:
            base = folder
            for _ in range(dots - 1):
                base = os.path.dirname(base)
            found += _modules(base, parts, wanted)
        elif parts[0] == top or (not top and _modules(root, parts[:1], [])):  # a single file, and those beside it
            found += _modules(root, parts, wanted)
        elif parts[0] == _PROGRAM:
            marks.add(_inlined())
        elif parts[0] not in _NOT_FOLLOWED and (other := _root_of(parts[0])):
            found += _modules(other, parts, wanted)
            marks.add(_release(other, parts[0]))
    return digest, tuple(found), tuple(sorted(marks))


@functools.cache
def _package_of(folder: str) -> tuple[str, str]:
    """The folder in which the outermost package of a folder lies, and its name; empty where there is none."""
    top = ""
    while os.path.isfile(os.path.join(folder, "__init__.py")):
        folder, top = os.path.split(folder)
    return folder, top


def _imports(text: bytes) -> Iterator[tuple[int, list[str], list[str]]]:
    """Of each statement that imports: how many dots it begins with, the parts of the module, names taken from it."""
    for dots, module, names in _IMPORT.findall(text):
        if dots or module:
            yield len(dots), module.decode().split(".") if module else [], _words(names)
    for modules in _PLAIN_IMPORT.findall(text):
        for module in _words(modules):
            yield 0, module.split("."), []


def _words(names: bytes) -> list[str]:
    return re.findall(r"[\w.]+", re.sub(r"\s+as\s+\w+", "", names.decode(errors="replace")))


def _modules(root: str, parts: list[str], names: list[str]) -> list[str]:
    """The files in which names of a module are defined, each of which may be a module itself; all without names."""
    base = os.path.join(root, *parts)
    if parts and os.path.isfile(f"{base}.py"):
        return [f"{base}.py"]
    package, found = os.path.join(base, "__init__.py"), []
    for name in names or [""]:
        places = (os.path.join(base, f"{name}.py"), os.path.join(base, name, "__init__.py")) if name else ()
        found.append(next(filter(os.path.isfile, places), package))
    return [file for file in found if file != package or os.path.isfile(package)]


@functools.cache
def _root_of(top: str) -> str:
    """The folder in which another package or module lies, without its import; empty if it has no source."""
    from importlib.util import find_spec

    try:
        spec = find_spec(top)
    except (ImportError, ValueError, AttributeError):
        return ""
    if spec is None:
        return ""
    if spec.submodule_search_locations:
        return os.path.dirname(next(iter(spec.submodule_search_locations)))
    return os.path.dirname(spec.origin) if spec.origin and spec.origin.endswith(".py") else ""


def _installed(root: str) -> bool:
    return os.path.basename(root) in ("site-packages", "dist-packages")


@functools.cache
def _release(root: str, top: str) -> str:
    """Which release of a package is installed; all there are where none has its name. Empty if it is a plain folder."""
    if not _installed(root):
        return ""
    there = sorted(name for name in os.listdir(root) if name.endswith("-info"))
    same = [name for name in there if re.sub(r"[-_.]+", "_", name).lower().startswith(f"{top.lower()}_")]
    return ",".join(same or there)


@functools.cache
def _inlined() -> str:
    """Digest of all of this program that may be inlined elsewhere."""
    h = hashlib.sha256()
    package = Path(__file__).parents[2]
    for part in ("services", "method", "features"):
        for file in sorted((package / part).rglob("*.py")):
            h.update(file.read_bytes())
    return h.hexdigest()


def _prune(base: Path, current: Path) -> None:
    """Remove the oldest states of a module."""
    others = [f for f in base.iterdir() if f.is_dir() and f != current]
    others.sort(key=lambda f: f.stat().st_mtime, reverse=True)
    for old in others[KEPT_STATES:]:
        shutil.rmtree(old, ignore_errors=True)


def kernel_cache_lasts() -> bool:
    """True if another process finds what is kept."""
    return kernel_cache_root() in _bases()


def source_of(place: str) -> tuple[str, str]:
    """The file of a kernel of this program, ``package.module:name``, and its name there."""
    module, _, name = place.partition(":")
    return str(Path(__file__).parents[3].joinpath(*module.split("."))) + ".py", name


def is_kept(place: str, specializations: int) -> bool:
    """True if Numba has compiled a kernel for so many kinds of arguments; does not load it."""
    source, name = source_of(place)
    return len(list(kernel_cache_folder(source).glob(f"*/{Path(source).stem}.{name}-*.nbc"))) >= specializations


@contextlib.contextmanager
def saving(folder: str | Path) -> Iterator[None]:
    """Let one process at a time save into a folder of kernels, where the system has locks.

    Numba reads the list of what is kept of a kernel, adds a file and writes the list again: two that do so at the same
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
    """Call what waits; `sppm_pipeline.services.jit.compiled` does so when Numba starts to compile."""
    while waiting:
        waiting.pop(0)()
