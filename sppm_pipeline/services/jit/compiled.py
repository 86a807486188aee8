"""The decorators that compile functions by Numba, so that all are cached on disk and release the GIL.

Kernels are compiled on their first call, not on import, and the machine code is kept (`machine_code`, and Numba's own
cache). Numba itself is imported when something has to be compiled, and by no run whose kernels are all kept. A caller
that notifies its user of the wait registers a callback with `sppm_pipeline.services.jit.kernel_cache`.
"""

from __future__ import annotations

import functools
import hashlib
import importlib
import threading
import types
from collections.abc import Callable
from typing import Any, TypeVar, cast

from numpy import ndarray

# not by `from`, which makes a module part of the state of all kernels: how code is kept does not change what it does
import sppm_pipeline.services.jit.kernel_cache as kernel_cache
import sppm_pipeline.services.jit.machine_code as machine_code

argument_kind, signature_as_json = machine_code.argument_kind, machine_code.signature_as_json
load, usable = machine_code.load, machine_code.usable
_NUMBERS = frozenset(machine_code.NUMBERS)

F = TypeVar("F", bound=Callable[..., Any])

_LOCK = threading.RLock()


def jit(function: F) -> F:
    """Compile `function` on first call with strict IEEE arithmetic, no GIL, cached on disk."""
    return cast(F, Kernel(function, False))


def inline_jit(function: F) -> F:
    """Compile `function` with reassociation and contraction allowed, for inner loops over contiguous rows.

    Only the flags that let LLVM vectorize are set: NaN and infinity keep their meaning. Squares are written as
    products: Numba compiles a power once in a process, and the first caller decides whether it may be contracted.
    """
    return cast(F, Kernel(function, {"reassoc", "contract", "arcp", "nsz"}))


def fused_jit(function: F) -> F:
    """Compile `function` with products and sums contracted, but in the order in which they are written.

    A sum of which only one term is a product comes out the same in a vector loop and in its remainder.
    """
    return cast(F, Kernel(function, {"contract"}))


class Kernel:
    """A function that is compiled for each kind of arguments when it is first called with them.

    To Numba, and for attributes that it does not have, it is the dispatcher that Numba makes of `py_func`.
    """

    def __init__(self, function: Callable[..., Any], fastmath: set[str] | bool) -> None:
        functools.update_wrapper(self, function)
        self.py_func: Any = function
        self._fastmath = fastmath
        self._dispatcher: Any = None  # for calls from Python
        self._inner: Any = None  # for calls from other kernels
        self._ready: dict[tuple[Any, ...], Callable[..., Any]] = {}

    def __call__(self, *args: Any, **named: Any) -> Any:
        key: list[Any] = []
        for value in args:  # written out, as it takes longer than everything else of a call
            kind = value.__class__
            if kind is ndarray:
                key += value.dtype, value.ndim, value.flags.num
            elif kind in _NUMBERS:
                key.append(kind)
            else:
                key.append(argument_kind(value))
        ready = self._ready.get(tuple(key))
        if ready is None or named:
            return self._first(tuple(key), args, named)
        return ready(*args)

    def _first(self, key: tuple[Any, ...], args: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """Call it with arguments of a kind that has not been there."""
        kinds = None if named or not usable() else [signature_as_json(argument_kind(value)) for value in args]
        if kinds is None or None in kinds:
            return self.dispatcher(*args, **named)
        ready = load(self.py_func, kinds)
        if ready is None:
            from sppm_pipeline.services.jit.compiling import keep

            ready = self.dispatcher
            result = ready(*args)
            keep(ready, tuple(map(ready.typeof_pyval, args)), kinds)
        else:
            result = ready(*args)
        self._ready[key] = ready
        return result

    @property
    def dispatcher(self) -> Any:
        """The function compiled by Numba; loads Numba."""
        if self._dispatcher is None:
            from sppm_pipeline.services.jit.compiling import dispatcher_of

            with _LOCK:
                if self._dispatcher is None:
                    self._dispatcher = dispatcher_of(self.py_func, self._fastmath)
        return self._dispatcher

    @property
    def _numba_type_(self) -> Any:
        """Numba asks for this where one kernel calls another, and where one is an argument."""
        if self._inner is None:
            from sppm_pipeline.services.jit.compiling import inner_dispatcher_of

            with _LOCK:
                if self._inner is None:
                    self._inner = inner_dispatcher_of(self.py_func, self._fastmath)
        return self._inner._numba_type_

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or "_dispatcher" not in self.__dict__:  # being copied, or asked for a protocol
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    def __reduce__(self) -> Any:
        return _kernel, (self.__module__, self.__qualname__)

    def __repr__(self) -> str:
        return f"<kernel {self.__module__}.{self.__qualname__}>"


class Intrinsic:
    """A function of compiled code that is written in LLVM's instructions; Numba makes it when it compiles a caller.

    `definition` is called once and returns what `numba.extending.intrinsic` takes; it imports Numba and llvmlite
    itself.
    """

    def __init__(self, definition: Callable[[], Callable[..., Any]]) -> None:
        self._definition = definition

    @functools.cached_property
    def _numba_type_(self) -> Any:
        from sppm_pipeline.services.jit.compiling import intrinsic_type

        return intrinsic_type(self._definition())


def _kernel(module: str, name: str) -> Any:
    return getattr(importlib.import_module(module), name)


def specialized(function: F, name: str, **replaced: Callable[..., Any]) -> F:
    """A copy of a function, not yet compiled, in which some global names mean other compiled functions.

    `function` stands at the top of its module. `name` distinguishes the copies of one function; with the code of what
    is replaced, and the state of the files that it is from, it becomes part of the name under which Numba keeps the
    copy.
    """
    h = hashlib.sha256()
    for other in replaced.values():
        plain = other.py_func  # type: ignore[attr-defined]
        code = plain.__code__
        h.update(repr((plain.__qualname__, code.co_code, code.co_consts, code.co_names)).encode())
        h.update(kernel_cache.state_of(code.co_filename).encode())  # values of globals, and what it calls
    copied = types.FunctionType(function.__code__, {**function.__globals__, **replaced})
    copied.__qualname__ = f"{function.__name__}_{name}_{h.hexdigest()[:8]}"
    return cast(F, copied)
