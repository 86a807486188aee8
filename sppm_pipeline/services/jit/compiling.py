"""Numba, as the kernels use it: its dispatchers, and a cache that is safe for several processes.

Nothing imports this module but `compiled`, when a kernel has to be compiled or Numba is to load it.
"""

from __future__ import annotations

import gc
import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numba
import numba.cpython.hashing
import numpy as np
from numba.core import config, event, types
from numba.core.caching import FunctionCache
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.typing.templates import builtin_registry
from numba.extending import intrinsic

# not by `from`, which makes a module part of the state of all kernels: how code is kept does not change what it does
import sppm_pipeline.services.jit.machine_code as machine_code
from sppm_pipeline.services.jit.kernel_cache import first_compilation, kernel_cache_folder, saving


def _choose_target() -> None:
    """Have Numba compile for the level of all kernels, unless another package has had it compile for this processor."""
    given = getattr(config, "CPU_NAME"), getattr(config, "CPU_FEATURES")  # noqa: B009 - declared at run time
    if machine_code.target() == machine_code.LEVEL and given == (None, None):
        if "_toplevel_target_context" in vars(cpu_target):
            machine_code.use_native()
        else:
            setattr(config, "CPU_NAME", machine_code.LEVEL)  # noqa: B010
            setattr(config, "CPU_FEATURES", "")  # noqa: B010


_choose_target()


def dispatcher_of(function: Callable[..., Any], fastmath: set[str] | bool) -> Any:
    """A function compiled by Numba for calls from Python, cached on disk."""
    # Numba asks for the folder when it makes a cache, and declares its settings at run time
    folder = str(kernel_cache_folder(function.__code__.co_filename))
    setattr(config, "CACHE_DIR", folder)  # noqa: B010
    wrapped = _compiled(function, fastmath)
    wrapped._cache = _Cache(function)  # type: ignore[no-untyped-call]
    wrapped._cache.folder, wrapped._cache.loaded = folder, {}
    return wrapped


def inner_dispatcher_of(function: Callable[..., Any], fastmath: set[str] | bool) -> Any:
    """The same for calls from compiled code, which becomes part of its callers.

    What only Python could call, and files for other processes, take an eighth of the time of compiling.
    """
    return _compiled(function, fastmath, no_cpython_wrapper=True)


def _compiled(function: Callable[..., Any], fastmath: set[str] | bool, **options: bool) -> Any:
    """Compiled without the GIL, with NumPy's division."""
    njit: Any = numba.njit  # whose annotations know fewer options than it has
    # no caller is written in C, and what only it could call takes a sixteenth of the time of compiling
    return njit(nogil=True, error_model="numpy", fastmath=fastmath, no_cfunc_wrapper=True, **options)(function)


def intrinsic_type(definition: Callable[..., Any]) -> Any:
    """The type of an intrinsic function, by which Numba finds it wherever a kernel names it."""
    made = intrinsic(definition)
    return next(kind for value, kind in reversed(builtin_registry.globals) if value is made)


class _Cache(FunctionCache):
    """Numba's cache of one function, safe for processes that save at the same time."""

    folder: str
    loaded: dict[Any, Any]  # of each signature what was on the disk

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # Numba would first make ready all that it can compile, a twentieth of the time of a short run. Machine code
        # needs the memory manager, and the symbols of `hashing` if it hashes; compiling makes the rest ready itself.
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            if not self._enabled:
                return None
            key = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
            data = self._cache_file.load(key)  # type: ignore[no-untyped-call]
            if data is None:
                return None
            self.loaded[sig] = data
            return self._impl.rebuild(target_context, data)

    def save_overload(self, sig: Any, data: Any) -> None:
        with saving(self.folder):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def keep(dispatcher: Any, signature: tuple[Any, ...], kinds: Sequence[Any]) -> None:
    """Keep the machine code that Numba has for the types `signature`, for arguments of these kinds."""
    compiled, cache = dispatcher.overloads.get(signature), dispatcher._cache
    if compiled is None or not machine_code.usable() or not cache._enabled or not cache._impl.check_cachable(compiled):
        return
    # what Numba's own cache writes
    written = cache.loaded.get(signature) or cache._impl.reduce(compiled)
    library, described, environment, _, objectmode, lifted, _, again, referenced = written
    if objectmode or lifted or again or library[1] != "object":
        return
    environments = {one.env_name: _dtypes(one.consts) for one in (environment, *referenced)}
    code = machine_code.Code(described.llvm_cpython_wrapper_name, environment.env_name, environments, library[2][0])
    machine_code.keep(dispatcher.py_func, kinds, code)


def read(kind: str | list[Any]) -> types.Type:
    """The Numba type of a JSON value; `ValueError` if there is no such type."""
    if isinstance(kind, list):
        module, _, name = kind[0].rpartition(".")
        made = getattr(importlib.import_module(module), name) if name else None
        joined: types.Type = types.BaseTuple.from_types(tuple(map(read, kind[1:])), made)  # type: ignore[no-untyped-call]
        return joined
    if kind == "none":
        return types.none
    name, *array = kind.split()
    number = types.boolean if name == "bool" else getattr(types, name, None)
    if not isinstance(number, types.Number | types.Boolean):
        raise ValueError(f"there is no number {name!r}")
    if not array:
        return number
    dimensions, order, *readonly = array
    made_of: Any = types.Array  # whose annotations know its orders one by one
    filled: types.Type = made_of(number, int(dimensions), order, readonly=bool(readonly))
    return filled


def compile_kernel(place: str, signatures: Sequence[Sequence[str | list[Any]]]) -> None:
    """Compile the kernel ``package.module:name`` for the argument types of each signature, or load it from the disk."""
    module, _, name = place.partition(":")
    kernel = getattr(importlib.import_module(module), name).dispatcher
    for kinds in signatures:
        signature = tuple(map(read, kinds))
        kernel.compile(signature)
        keep(kernel, signature, kinds)


def _dtypes(constants: list[Any]) -> list[str] | None:
    """The constants of an environment as text, if all are dtypes of numbers."""
    plain = all(isinstance(one, np.dtype) and one.fields is None for one in constants)
    return [one.str for one in constants] if plain else None


class _Compilation(event.Listener):
    """Notes the first compilation, and has garbage collected rarely while a kernel is compiled.

    Next to all that the compiler makes lives on, so that looking it over takes a tenth of the time. Numba holds a lock
    from the start of the outermost compilation to its end.
    """

    depth = 0
    thresholds = gc.get_threshold()

    def on_start(self, event: Any) -> None:
        first_compilation()
        if not self.depth:
            self.thresholds = gc.get_threshold()
            gc.set_threshold(10_000, 10, 1000)
        self.depth += 1

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if not self.depth:
            gc.set_threshold(*self.thresholds)


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]
