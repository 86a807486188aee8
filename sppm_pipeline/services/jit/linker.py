"""Object code of kernels, linked by LLVM and started without the import of Numba.

Numba's own extension modules, loaded by their files, lend what compiled code calls.
"""

from __future__ import annotations

import builtins
import ctypes
import functools
import importlib
import importlib.machinery
import importlib.util
import os
import pickle
import struct
import sys
from collections.abc import Callable
from types import FunctionType, ModuleType
from typing import Any

import numpy as np


@functools.cache
def numba_folder() -> str:
    """The folder of Numba, without its import."""
    found = importlib.util.find_spec("numba")
    if found is None or not found.submodule_search_locations:
        raise ImportError("Numba is not installed")
    return found.submodule_search_locations[0]


@functools.cache
def linker() -> Linker:
    return Linker()


class Linker:
    """LLVM's linker, with the symbols that Numba's code looks for."""

    def __init__(self) -> None:
        import llvmlite.binding as llvm

        self._llvm = llvm
        self._known: set[str] = set()
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        self._target = llvm.Target.from_triple(llvm.get_process_triple())
        self._dynfunc, helpers, memory = map(_extension, ("_dynfunc", "_helperlib", "core.runtime._nrt_python"))
        memory.memsys_use_cpython_allocator()
        # under the names that Numba gives them; exceptions are the classes, not pointers to them as in Python's library
        symbols = {f"PyExc_{n}": id(e) for n, e in vars(builtins).items() if _is_exception(e)}
        symbols["_Py_NoneStruct"] = id(None)
        symbols |= {n if n.startswith("_") else f"NRT_{n}": address for n, address in memory.c_helpers.items()}
        for table in (helpers.c_helpers, self._dynfunc.c_helpers):
            symbols |= {f"numba_{name}": address for name, address in table.items()}
        symbols |= {name: helpers.c_helpers[name] for name in _MATH if name in helpers.c_helpers}
        symbols["numba_unpickle"] = ctypes.cast(_UNPICKLE, ctypes.c_void_p).value or 0
        for name, address in symbols.items():
            llvm.add_symbol(name, address)
            self._known.add(name)

    def start(self, about: dict[str, Any], code: bytes, function: FunctionType) -> Callable[..., Any] | None:
        """Link object code and return the function that Python calls; None if a symbol is missing.

        Each kernel is linked by itself: two may hold functions of one name, made by different processes.
        """
        llvm = self._llvm
        # the machine is the engine's from here; the first engine lets LLVM see the symbols of this process
        engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), self._target.create_target_machine(jit=True))
        for name in about["symbols"]:
            if name not in self._known:
                if not llvm.address_of_symbol(name):
                    return None  # LLVM would end the process
                self._known.add(name)
        file = llvm.ObjectFileRef.from_data(code)
        engine.add_object_file(file)
        engine.finalize_object()
        environments = {}
        for symbol, constants in about["environments"].items():
            made = self._dynfunc.Environment({})  # globals are for code that is interpreted
            made.consts[:] = [np.dtype(text) for text in constants]
            environments[symbol] = made
            if address := engine.get_global_value_address(symbol):
                ctypes.c_void_p.from_address(address).value = id(made)
        module, name = sys.modules[function.__module__], function.__name__
        kept = (engine, file, *environments.values())
        environment = environments[about["environment"]]
        entry = engine.get_function_address(about["entry"])
        if not entry:
            return None
        started: Callable[..., Any] = self._dynfunc.make_function(
            module, name, function.__doc__ or "", entry, environment, kept
        )
        return started


def _is_exception(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, BaseException)


_MATH = (
    *(name + end for end in ("", "f") for name in (
        "sin", "cos", "tan", "sinh", "cosh", "tanh", "asin", "acos", "atan", "asinh", "acosh", "atanh", "exp", "expm1",
        "sqrt", "fabs", "floor", "ceil", "log", "log10", "log1p", "round", "trunc", "pow", "fmod", "atan2",
    )),
)  # fmt: skip
"""Functions of C that compiled code calls as Python itself does."""


def _extension(name: str) -> ModuleType:
    """One of Numba's extension modules by its file; not entered into `sys.modules`, so that Numba may import it."""
    full = f"numba.{name}"
    if full in sys.modules:
        return sys.modules[full]
    stem = os.path.join(numba_folder(), *name.split("."))
    for suffix in importlib.machinery.EXTENSION_SUFFIXES:
        if os.path.exists(stem + suffix):
            spec = importlib.util.spec_from_file_location(full, stem + suffix)
            assert spec is not None
            assert spec.loader is not None
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            sys.modules.pop(full, None)  # where modules of this old kind enter themselves
            return module
    raise ImportError(f"there is no {stem}")


_unpickled: dict[tuple[int, bytes], Any] = {}


def _unpickle(data: int, length: int, digest: int) -> Any:
    """Types and exceptions that compiled code holds; Numba's own asks for all of Numba."""
    key = data, ctypes.string_at(digest, 20)
    if key not in _unpickled:
        _unpickled[key] = pickle.loads(ctypes.string_at(data, length))
    return _unpickled[key]


_UNPICKLE = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)(_unpickle)


def symbols_of(data: bytes) -> tuple[list[str], set[str]] | None:
    """Symbols that an object file (ELF, 64 bits, little-endian) looks for elsewhere, and all that its code uses.

    See the System V ABI, chapters "ELF header", "Sections", "Symbol table" and "Relocation". None for other files.
    """
    if data[:6] != b"\x7fELF\x02\x01":
        return None
    (table,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [struct.unpack_from("<IIQQQQIIQQ", data, table + number * size) for number in range(count)]
    relocated = {
        struct.unpack_from("<Q", data, at + 8)[0] >> 32
        for section in sections
        if section[1] == _RELOCATIONS
        for at in range(section[4], section[4] + section[5], 24)
    }
    wanted, used = set(), set()
    for _, kind, _, _, start, length, link, *_ in sections:
        if kind == _SYMBOLS:
            for number, at in enumerate(range(start, start + length, 24)):
                name, _, _, section = struct.unpack_from("<IBBH", data, at)
                first = sections[link][4] + name  # the section of their names
                text = data[first : data.index(b"\0", first)].decode()
                if number in relocated:
                    used.add(text)
                if section == 0 and text:
                    wanted.add(text)
    return sorted(wanted), used


_SYMBOLS, _RELOCATIONS = 2, 4
"""Types of sections."""
