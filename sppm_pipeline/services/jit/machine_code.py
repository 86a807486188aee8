"""Machine code of kernels, kept so that it starts without the compiler that made it.

Numba's own cache needs all of Numba to be imported, a third of a short run, only to hand over code that is finished.
So the object code of each kernel that Python has called is kept once more, beside Numba's files, with all that it takes
to start it: the name of its entry, the symbols that it looks for, and the environments of its functions. LLVM links it,
and two of Numba's extension modules, which are loaded by their files, lend it what compiled code calls: conversions of
arguments, memory, exceptions. The machine code is the same, so results are, to the byte.

The distribution `sppm-kernels` brings such files, made by `.ci/kernels.py` for `LEVEL`. Numba compiles for that as well
unless `TARGET` says ``native``, so that the same code runs on every processor that has it. A file is found by its name,
a digest of the sources that the kernel reaches and of all else that the code depends on (`_file_of`): where none fits,
for instance after an edit, the kernel is compiled and kept in the user's folder.

Whatever does not fit is left to Numba: other kinds of arguments, a symbol that is not there, a damaged file, a setting
of Numba's in the environment, a version of Numba that this has not been tried with (`SUPPORTED_NUMBA`, as symbols of
compiled code are no promise of Numba's), another system than Linux on x86-64 (object files are read here to know what
symbols they want, as LLVM ends the process where one is missing; others have not been tried).
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.machinery
import importlib.util
import json
import os
import re
import struct
import sys
import threading
import zlib
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np

from sppm_pipeline.services.jit.kernel_cache import installed_folder, kernel_cache_folder, state_of
from sppm_pipeline.services.jit.linker import linker, numba_folder, symbols_of
from sppm_pipeline.services.private_folder import writers

FORMAT = 5
"""Of the files; part of their names."""

LEVEL = "x86-64-v3"
"""Microarchitecture level of the x86-64 psABI that kernels are compiled for where the processor has it: AVX2 and fused
multiply-add, processors from about 2013 on."""

_OF_LEVEL = frozenset(b"avx avx2 bmi1 bmi2 f16c fma abm movbe xsave".split())
"""Its instruction sets beyond the level before, as Linux calls them."""

TARGET = "SPPM_TARGET"
"""Environment variable; ``native`` has kernels compiled for this very processor, as ``--target native`` does."""

SHIPPED = "sppm_kernels"
"""Package of the distribution with machine code for `LEVEL`."""

ENV_VAR = "SPPM_KEPT_KERNELS"
"""Environment variable; ``off`` has Numba start all kernels."""

SUPPORTED_NUMBA = ("0.68",)
"""Versions of Numba, without their last number, whose code was started without it, and all tests passed."""

_CHOSEN = frozenset(("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES"))
"""Settings of Numba by which its user chooses the processor."""

_CPUINFO = "/proc/cpuinfo"

_MAGIC = b"sppm machine code\n"

_SETTINGS = ("NUMBA_CACHE_DIR",)
"""Settings of Numba that do not change what it makes."""

NUMBERS: dict[type, str] = {
    int: "int64",
    float: "float64",
    bool: "bool",
    **{
        getattr(np, name): name.rstrip("_")
        for name in ("bool_", "float32", "float64", "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32",
                     "uint64")
    },
}  # fmt: skip
"""Scalars that kernels take, and Numba's names for them."""

_C, _F, _ALIGNED, _WRITABLE = 0x1, 0x2, 0x100, 0x400
FLAGS = _C | _F | _ALIGNED | _WRITABLE
"""Those of `ndarray.flags.num` that tell kinds of arrays apart."""


class TooLarge:
    """Stands for an int that does not fit into 64 bits with a sign.

    As the first of its kind in a call, it leaves the call to Numba; kept code that was started for a smaller one is
    called with it all the same, and raises OverflowError.
    """


def argument_kind(value: Any) -> Any:
    """Kind of an argument, to look kernels up by; cheap, as each call of a kernel asks for it."""
    kind = type(value)
    if kind is np.ndarray or kind is np.memmap:
        return value.dtype, value.ndim, value.flags.num & FLAGS
    if kind is int:
        return int if value.bit_length() < 64 else TooLarge
    if isinstance(value, tuple):
        return (kind, *map(argument_kind, value))
    return kind


def signature_as_json(kind: Any) -> str | list[Any] | None:
    """A kind as a JSON value, of which `compiling.read` makes Numba's type; None for kinds that are left to Numba.

    A number is written as Numba calls it (``"int64"``), an array as ``"float32 3 C"`` with its dimensions and its order
    in memory, and ``"float32 3 C readonly"`` if it can't be written to; a tuple as a list that begins with its class,
    which is empty for a plain one; None as ``"none"``.
    """
    if not isinstance(kind, tuple):
        return "none" if kind is type(None) else NUMBERS.get(kind)
    if isinstance(kind[0], type):
        parts = [signature_as_json(part) for part in kind[1:]]
        if any(part is None for part in parts):
            return None
        return ["" if kind[0] is tuple else f"{kind[0].__module__}.{kind[0].__qualname__}", *parts]
    dtype, dimensions, flags = kind
    if not flags & _ALIGNED or not dtype.isnative or dtype.type not in NUMBERS:
        return None
    order = "C" if flags & _C else "F" if flags & _F else "A"
    return f"{NUMBERS[dtype.type]} {dimensions} {order}" + ("" if flags & _WRITABLE else " readonly")


class Code(NamedTuple):
    """Object code of a kernel and what it takes to start it; `entry` is the symbol of the function that Python calls.

    `environments`, by symbol, are those of this function and those that it calls: the only constants kept are dtypes,
    of arrays that are made, None if there are others. `environment` is that of the entry.
    """

    entry: str
    environment: str
    environments: dict[str, list[str] | None]
    object: bytes


@functools.cache
def reason_unavailable() -> str:
    """Why no kept code is used; nothing where it is."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return "tried on Linux on x86-64 only"
    if os.environ.get(ENV_VAR, "").lower() == "off":
        return f"{ENV_VAR}=off"
    if settings := [n for n in sorted(os.environ) if n.startswith("NUMBA_") and n not in _SETTINGS]:
        return f"{settings[0]} is set"
    if os.path.exists(".numba_config.yaml"):  # where Numba looks for settings, too
        return "there is a .numba_config.yaml here"
    version = _version()
    return "" if version.rpartition(".")[0] in SUPPORTED_NUMBA else f"not tried with Numba {version}"


def usable() -> bool:
    """True if kept code is used at all."""
    return not reason_unavailable()


@functools.cache
def _version() -> str:
    """Numba's, from its files, as its import is what all this saves."""
    with contextlib.suppress(OSError, ImportError):
        with open(os.path.join(numba_folder(), "_version.py"), encoding="utf-8") as file:
            found = re.search(r'"version": "([^"]+)"', file.read())
        if found:
            return found[1]
    return ""


@functools.cache
def target() -> str:
    """What kernels are compiled for: `LEVEL`, or ``native``."""
    if os.environ.get(TARGET, "").lower() == "native" or not _CHOSEN.isdisjoint(os.environ):
        return "native"
    with contextlib.suppress(OSError), open(_CPUINFO, "rb") as file:
        found = re.search(rb"^flags\s*:(.*)$", file.read(1 << 14), re.MULTILINE)
        if found and _OF_LEVEL.issubset(found[1].split()):
            return LEVEL
    return "native"


def use_native() -> None:
    """From here on, here and in child processes, take and make machine code for this very processor."""
    os.environ[TARGET] = "native"
    for cached in (target, _made_by, shipped):
        cached.cache_clear()


@functools.cache
def _made_by() -> tuple[str, ...]:
    """What makes machine code, and for which processor; parts of versions that change no code are left out."""
    made = importlib.machinery.EXTENSION_SUFFIXES[0], _version().rpartition(".")[0], np.__version__.partition(".")[0]
    if target() == LEVEL:
        return *made, LEVEL
    import llvmlite.binding as llvm

    return *made, llvm.get_process_triple(), llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _file_of(source: str, name: str, kinds: Sequence[Any]) -> str:
    """Name of the file of a kernel of a module for arguments of these kinds, as `signature_as_json`."""
    about = json.dumps([FORMAT, state_of(source), name, list(kinds), *_made_by()])
    return f"{name}-{hashlib.sha256(about.encode()).hexdigest()[:20]}.code"


def _place_of(function: FunctionType, kinds: Sequence[Any]) -> tuple[str, str] | None:
    """Source and file name of a kernel; None if it can't be kept.

    A function with a closure is made again in every process, and what it holds may differ; of one without a file, the
    state of what it reaches is not known.
    """
    source, name = function.__code__.co_filename, function.__qualname__
    if function.__closure__ is not None or not name.replace(".", "").isidentifier() or not state_of(source):
        return None
    return source, _file_of(source, name, kinds)


@functools.cache
def shipped() -> str:
    """The folder of machine code that was installed; empty if there is none, or others may write to it."""
    folder, reason = installed_folder(SHIPPED) if usable() and target() == LEVEL else ("", "")
    if reason:
        refused[folder] = reason
    return "" if reason else folder


refused: dict[str, str] = {}
"""Folders and files of machine code that are not used, and why."""


def is_shipped(source: str, name: str, kinds: Sequence[Any]) -> bool:
    """True if a kernel of a module file was installed with its machine code; does not read it."""
    return bool(shipped()) and os.path.exists(os.path.join(shipped(), _file_of(source, name, kinds)))


def keep(function: FunctionType, kinds: Sequence[Any], code: Code) -> None:
    """Keep machine code, if all symbols that it needs can be listed; the file appears whole or not at all."""
    place, symbols = _place_of(function, kinds), symbols_of(code.object)
    if place is None or symbols is None:
        return
    # most functions are inlined, and no code asks for the environments that they would have had
    needed = {n: dtypes for n, dtypes in code.environments.items() if n == code.environment or n in symbols[1]}
    if None in needed.values():
        return
    about = {"entry": code.entry, "environment": code.environment, "environments": needed, "symbols": symbols[0]}
    head = json.dumps(about | {"of": _of(function), "by": _versions()}, separators=(",", ":")).encode()
    file = os.path.join(kernel_cache_folder(place[0]), place[1])
    new = f"{file}.{os.getpid()}-{threading.get_ident()}"
    whole = struct.pack("<I", len(head)) + head + code.object
    try:
        with open(new, "wb") as opened:
            opened.write(_MAGIC + struct.pack("<I", zlib.crc32(whole)) + whole)
        os.replace(new, file)
    except OSError:  # a full disk, as a rule
        with contextlib.suppress(OSError):
            os.unlink(new)


def _of(function: FunctionType) -> list[Any]:
    """Which of several functions of one name it is."""
    code = function.__code__
    return [function.__module__, code.co_firstlineno, hashlib.sha256(code.co_code).hexdigest()[:20]]


def load(function: FunctionType, kinds: Sequence[Any]) -> Callable[..., Any] | None:
    """Start kept machine code; None if there is none, or it can't be started here."""
    place = _place_of(function, kinds)
    if place is None:
        return None
    if shipped() and (started := _start(os.path.join(shipped(), place[1]), function, "")):
        return started
    return _start(os.path.join(kernel_cache_folder(place[0]), place[1]), function, _versions())


def _versions() -> str:
    return f"{_version()} {np.__version__}"


def _start(file: str, function: FunctionType, versions: str) -> Callable[..., Any] | None:
    """Start what a file holds, if it was made by these versions; by any that fit if they are empty."""
    if (found := read(file)) is None:
        return None
    about, code = found
    try:
        if about["of"] != _of(function) or (versions and about["by"] != versions):
            return None
        with _LOADING:
            if started := linker().start(about, code, function):
                return started
        refused[file] = "a symbol that it needs is missing"
    except (OSError, ValueError, KeyError, TypeError, AttributeError, ImportError, RuntimeError) as error:
        refused[file] = f"it can't be started: {error}"
    return None


def read(file: str) -> tuple[dict[str, Any], bytes] | None:
    """What is said about machine code in a file, and the code; None if there is none, or it is refused."""
    try:
        with open(file, "rb") as opened:
            if reason := writers(os.fstat(opened.fileno())):
                refused[file] = reason
                return None
            data = opened.read()
    except OSError:
        return None
    with contextlib.suppress(struct.error, ValueError):
        check, length = struct.unpack_from("<II", data, len(_MAGIC))
        at = len(_MAGIC) + 8
        if data.startswith(_MAGIC) and zlib.crc32(memoryview(data)[len(_MAGIC) + 4 :]) == check:
            return json.loads(data[at : at + length]), data[at + length :]
    refused[file] = "it is damaged"
    return None


_LOADING = threading.RLock()
