"""Dependencies of a result besides its options: the code that makes it, and the libraries below that code."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import sppm_pipeline
from sppm_pipeline.engine.plan.installed import distributions, metadata_of, normal, version_of
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.services.jit.machine_code import target
from sppm_pipeline.stage import Stage

_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "pillow")
"""Libraries that count for every stage; of other requirements only those count that a stage names as
`Stage.libraries`."""

_PACKAGE = "sppm_pipeline"
_WITHOUT_RESULTS = ("engine/cli", "features/browser/report", "features/browser/studio", "testing")
"""Folders that no result comes from."""

_SETTINGS = (
    "NUMBA_CPU_NAME",
    "NUMBA_CPU_FEATURES",
    "NUMBA_DISABLE_JIT",
    "NUMBA_OPT",
    "NPY_DISABLE_CPU_FEATURES",
    "OPENBLAS_CORETYPE",
)
"""Environment variables by which the same code computes other last digits."""


@functools.cache
def program_digest() -> str:
    """Digest of the program's own source; an edit anywhere counts as another program."""
    root = Path(str(sppm_pipeline.__file__)).parent
    return _tree_digest(root, skip=_WITHOUT_RESULTS)


def code_of(cls: type[Stage], owner: Plugin) -> dict[str, Any]:
    """Supplier of a stage, in which version, and the digest of the source of all classes that it is made of."""
    modules = {c.__module__ for c in cls.__mro__ if c is not object}
    sources = {_source_of(module) for module in modules}
    # sorted, as sets have no order that two processes share
    digest = hashlib.sha256("\n".join(sorted(sources - {""})).encode()).hexdigest()
    if owner.builtin:
        return {"supplier": _PACKAGE, "version": sppm_pipeline.__version__, "digest": digest}
    # the place of a single file is no part of what it does
    supplier = owner.distribution or os.path.basename(owner.name)
    return {"supplier": supplier, "version": owner.version, "digest": digest}


def has_files(cls: type[Stage]) -> bool:
    """Whether files hold the code of a stage: what a notebook defines is in none, and may change unseen."""
    modules = {c.__module__ for c in cls.__mro__[:-1]}
    own = {name for name in modules if name.partition(".")[0] not in sys.stdlib_module_names - {"__main__"}}
    return all(getattr(sys.modules.get(name), "__file__", None) for name in own)


@functools.cache
def _source_of(module: str) -> str:
    """Digest of a module's own package; empty for the standard library, whose version is that of Python."""
    top = module.partition(".")[0]
    if top == _PACKAGE:
        own = getattr(sys.modules.get(module), "__file__", None) or ""
        place = module.partition(".")[2].replace(".", "/") + "/"
        apart = any(place.startswith(f"{folder}/") for folder in _WITHOUT_RESULTS)
        return program_digest() + (_file_digest(Path(own)) if apart else "")
    if top in sys.stdlib_module_names:
        return ""
    found = sys.modules.get(top)
    file = getattr(found, "__file__", None)
    if file is None:
        return f"{module} without a file"
    path = Path(file)
    return _tree_digest(path.parent) if path.name == "__init__.py" else _file_digest(path)


def _tree_digest(root: Path, skip: Iterable[str] = ()) -> str:
    """Digest of all Python files below a folder."""
    total = hashlib.sha256()
    for folder, folders, files in os.walk(root):
        below = Path(folder).relative_to(root)
        folders[:] = sorted(f for f in folders if f != "__pycache__" and (below / f).as_posix() not in skip)
        for name in sorted(files):
            if name.endswith(".py"):
                path = Path(folder, name)
                total.update(f"{path.relative_to(root).as_posix()}\0{_file_digest(path)}\n".encode())
    return total.hexdigest()


def _file_digest(path: Path) -> str:
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return "unreadable"


@functools.cache
def environment(libraries: tuple[str, ...] = (), plugins: tuple[str, ...] = ()) -> dict[str, str]:
    """Versions of Python and the libraries in use, and the kind of processor.

    Threads do not count, as results do not depend on them. The processor does, and what kernels are compiled for: they,
    numpy and BLAS add in an order that depends on how wide its registers are. `libraries` count besides those that
    every stage uses, and so do requirements of the distributions `plugins`.
    """
    names = {*_LIBRARIES, *libraries}.union(*map(requirements_of, plugins))
    found = {"python": platform.python_version(), "processor": _processor(), "kernels": target()}
    found |= {name: installed_version(name) or "not installed" for name in sorted(names)}
    return found | {name: os.environ[name] for name in _SETTINGS if name in os.environ}


def _processor() -> str:
    """Architecture, model and instruction sets of the first processor."""
    about = [platform.machine(), sys.platform]
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            text = file.read(1 << 14).split("\n\n")[0]
    except OSError:
        text = platform.processor()
    # these change from moment to moment or core to core, and no result with them
    kept = [line for line in text.splitlines() if not re.match(r"(cpu MHz|bogomips|apicid|initial apicid)", line)]
    wanted = ("vendor_id", "cpu family", "model", "stepping", "flags", "Features", "CPU ")
    described = "\n".join(line for line in kept if line.startswith(wanted)) or text
    return "-".join(about) + "-" + hashlib.sha256(described.encode()).hexdigest()[:12]


def arithmetic() -> dict[str, str | None]:
    """Dependencies of the last digits of numbers besides versions, for the run record.

    These are ``processor``, its name as the system says it, and ``instructions``, a digest of what it can do;
    ``numba_target``, what kernels are compiled for, None in a process that compiled nothing for its very processor;
    ``blas``, the linear algebra below numpy, which chooses its code by the processor as numpy does; and environment
    variables that change them.
    """
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    compiled_for = None if target() == "native" else target()
    if compiled_for is None and "llvmlite.binding" in sys.modules:
        # not imported for this: a process that compiled nothing has not loaded LLVM
        compiled_for = os.environ.get("NUMBA_CPU_NAME") or sys.modules["llvmlite.binding"].get_host_cpu_name()
    return {
        "processor": _processor_name(),
        "instructions": _processor(),
        "numba_target": compiled_for,
        "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip(),
    } | {name: os.environ[name] for name in _SETTINGS if name in os.environ}


def _processor_name() -> str:
    with contextlib.suppress(OSError), open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
        found = re.search(r"^model name\s*: (.+)$", file.read(1 << 14), re.MULTILINE)
        if found:
            return found[1]
    return platform.processor() or platform.machine()


_REQUIRED = re.compile(r"^Requires-Dist: ([\w.-]+)(.*)$", re.MULTILINE)
_OF_DEVELOPERS = ("test", "dev", "docs")
_NOT_IN_USE = re.compile(rf"extra\s*==\s*['\"]({'|'.join(_OF_DEVELOPERS)})['\"]")


def installed_version(name: str) -> str | None:
    """The version of a distribution; None if it is not installed."""
    found = _installed().get(normal(name))
    return version_of(found) if found else None


_MODULES = {"PIL": "pillow", "skimage": "scikit-image", "nrrd": "pynrrd", "dateutil": "python-dateutil"}
"""Distributions of modules that have another name."""


def imported_versions() -> dict[str, str]:
    """Versions of all distributions of which a module is imported in this process."""
    names = {name.partition(".")[0] for name, module in list(sys.modules.items()) if getattr(module, "__file__", None)}
    names |= {".".join(name.split(".")[:2]) for name in list(sys.modules) if name.startswith("ruamel.")}  # a namespace
    found: set[str] = set()
    for name in names - sys.stdlib_module_names - {_PACKAGE}:
        if (wanted := normal(_MODULES.get(name, name))) in _installed():
            found.add(wanted)
        elif not name.startswith("_"):
            found.update(map(normal, _distributions_of_modules().get(name, ())))
    return {name: version for name in sorted(found) if (version := installed_version(name)) is not None}


@functools.cache
def _distributions_of_modules() -> Mapping[str, list[str]]:
    from importlib.metadata import packages_distributions  # takes a tenth of a second, for names like no distribution's

    return packages_distributions()


def requirements_of(name: str) -> list[str]:
    """Names of the distributions that one requires, for itself or for an extra other than those of its developers."""
    found = _installed().get(normal(name))
    if found is None:
        return []
    head = metadata_of(found)
    names = {normal(wanted) for wanted, how in _REQUIRED.findall(head) if not _NOT_IN_USE.search(how)}
    with contextlib.suppress(OSError), open(os.path.join(found.folder, "requires.txt"), encoding="utf-8") as file:
        names |= set(_required_of_egg(file.read()))
    return sorted(names)


def _required_of_egg(text: str) -> Iterator[str]:
    """Names in ``requires.txt``, in which sections are extras: ``[extra]`` or ``[extra:marker]``."""
    extra = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("["):
            extra = line.strip("[]").partition(":")[0]
        elif extra not in _OF_DEVELOPERS and (found := re.match(r"[\w.-]+", line)):
            yield normal(found[0])


_installed = functools.cache(distributions)
