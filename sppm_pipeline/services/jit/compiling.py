"""Numba, as the kernels use it: its dispatchers, and a cache that is safe for several processes.

Nothing imports this module but `compiled`, when a kernel has to be compiled or Numba is to load it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numba.cpython.hashing
import numpy as np
from numba.core import config, event
from numba.core.caching import FunctionCache
from numba.core.registry import cpu_target
from numba.core.runtime.nrt import rtsys
from numba.core.typing.templates import builtin_registry
from numba.extending import intrinsic

# not by `from`, which makes a module part of the state of all kernels: how code is kept does not change what it does
import sppm_pipeline.services.jit.machine_code as machine_code
from sppm_pipeline.services.jit.kernel_cache import first_compilation, kernel_cache_folder, saving
from sppm_pipeline.services.jit.kernel_signatures import signature_as_json


def _load_numba_without_scipy() -> None:
    """Load the part of Numba that looks for BLAS, answering its question without the import of scipy.linalg.

    That import takes longer than everything else in a short run; if `numpy.dot` is compiled after all, BLAS is found
    then.
    """
    from numba.np import linalg

    look = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = look


_load_numba_without_scipy()


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
    """A function compiled by Numba: compiled without the GIL, with NumPy's division, cached on disk."""
    # Numba asks for the folder when it makes a cache, and declares its settings at run time
    folder = str(kernel_cache_folder(function.__code__.co_filename))
    setattr(config, "CACHE_DIR", folder)  # noqa: B010
    # no caller is written in C, and what only it could call takes a sixteenth of the time of compiling
    njit: Any = numba.njit  # whose annotations know fewer options than it has
    wrapped: Any = njit(nogil=True, error_model="numpy", fastmath=fastmath, no_cfunc_wrapper=True)(function)
    wrapped._cache = _Cache(function)  # type: ignore[no-untyped-call]
    wrapped._cache.folder = folder
    return wrapped


def intrinsic_type(definition: Callable[..., Any]) -> Any:
    """The type of an intrinsic function, by which Numba finds it wherever a kernel names it."""
    made = intrinsic(definition)
    return next(kind for value, kind in reversed(builtin_registry.globals) if value is made)


class _Cache(FunctionCache):
    """Numba's cache of one function, safe for processes that save at the same time.

    With `keep`, Python calls the function, and its machine code is kept to be started without Numba as well.
    """

    folder: str
    keep = False

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
            if self.keep:
                self._keep(sig, data)
            return self._impl.rebuild(target_context, data)

    def save_overload(self, sig: Any, data: Any) -> None:
        with saving(self.folder):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        if self.keep and self._enabled and self._impl.check_cachable(data):
            self._keep(sig, self._impl.reduce(data))

    def keep_from_now(self, compiled: dict[Any, Any]) -> None:
        """Keep what is compiled from here on, and what was compiled before, as another kernel calls it."""
        if not self.keep:
            self.keep = True
            for one in compiled.values():
                if self._enabled and self._impl.check_cachable(one):
                    self._keep(one.signature.args, self._impl.reduce(one))

    def _keep(self, sig: Any, data: Any) -> None:
        """Keep machine code that Numba has made; `data` is what Numba's own cache writes."""
        if not machine_code.usable() or len(data) != 9:
            return
        library, described, environment, _, objectmode, lifted, _, again, referenced = data
        if objectmode or lifted or again or library[1] != "object":
            return
        try:
            kinds = [signature_as_json(kind) for kind in sig]
        except ValueError:
            return
        environments = {one.env_name: _dtypes(one.consts) for one in (environment, *referenced)}
        code = machine_code.Code(described.llvm_cpython_wrapper_name, environment.env_name, environments, library[2][0])
        machine_code.keep(self._py_func, kinds, code)


def _dtypes(constants: list[Any]) -> list[str] | None:
    """The constants of an environment as text, if all are dtypes of numbers."""
    plain = all(isinstance(one, np.dtype) and one.fields is None for one in constants)
    return [one.str for one in constants] if plain else None


class _Compilation(event.Listener):
    def on_start(self, event: Any) -> None:
        first_compilation()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]
