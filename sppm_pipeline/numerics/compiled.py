"""The decorators that compile functions by Numba, so that all are cached on disk and release the GIL.

Kernels are compiled on their first call, not on import, and the machine code is kept in Numba's cache; a caller
that notifies its user of the wait registers a callback with `sppm_pipeline.numerics.kernel_cache`.
"""

from __future__ import annotations

import hashlib
import types
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numba.cpython.hashing
from numba.core import config, event
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

from sppm_pipeline.numerics.kernel_cache import first_compilation, kernel_cache_folder, saving


def _load_numba_without_scipy() -> None:
    """Load the part of Numba that looks for BLAS, answering its question without the import of scipy.linalg.

    That import takes longer than everything else in a short run, and is there only to tell whether `numpy.dot` can be
    compiled. If somebody compiles it after all, Numba finds BLAS when it is called.
    """
    from numba.np import linalg

    look = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        linalg.ensure_blas = look


_load_numba_without_scipy()

F = TypeVar("F", bound=Callable[..., Any])


def jit(function: F) -> F:
    """Compile `function` on first call with strict IEEE arithmetic, no GIL, cached on disk."""
    return _compiled(function, False)


def inline_jit(function: F) -> F:
    """Compile `function` with reassociation and contraction allowed, for inner loops over contiguous rows.

    Only the flags that let LLVM vectorize are set: NaN and infinity keep their meaning.
    """
    return _compiled(function, {"reassoc", "contract", "arcp", "nsz"})


def fused_jit(function: F) -> F:
    """Compile `function` with products and sums contracted, but in the order in which they are written.

    A sum of which only one term is a product comes out the same in a vector loop and in its remainder.
    """
    return _compiled(function, {"contract"})


def _compiled(function: F, fastmath: set[str] | bool) -> F:
    # Numba asks for the folder when it makes a cache, and declares its settings at run time
    folder = str(kernel_cache_folder(function.__code__.co_filename))
    setattr(config, "CACHE_DIR", folder)  # noqa: B010
    # no caller is written in C, and what only it could call takes a sixteenth of the time of compiling
    njit: Any = numba.njit  # whose annotations know fewer options than it has
    wrapped: Any = njit(nogil=True, error_model="numpy", fastmath=fastmath, no_cfunc_wrapper=True)(function)
    wrapped._cache = _Cache(function)  # type: ignore[no-untyped-call]
    wrapped._cache.folder = folder
    return wrapped  # type: ignore[no-any-return]


class _Cache(FunctionCache):
    """Numba's cache of one function, safe for processes that save at the same time."""

    folder: str

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        # Numba would first make ready all that it can compile, a twentieth of the time of a short run. Machine code
        # needs the memory manager, and the symbols of `hashing` if it hashes; compiling makes the rest ready itself.
        rtsys.initialize(target_context)
        with self._guard_against_spurious_io_errors():
            return self._load_overload(sig, target_context)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        with saving(self.folder):
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]


def specialized(function: F, name: str, **replaced: Callable[..., Any]) -> F:
    """A copy of a function, not yet compiled, in which some global names mean other functions.

    Parameters
    ----------
    function : callable
        A plain function at the top of its module.
    name : str
        Tells the copies of one function apart; with the code of what is replaced it becomes part of the name under
        which Numba keeps the compiled copy.
    **replaced : callable
        Compiled functions by the global name they take over.
    """
    h = hashlib.sha256()
    for other in replaced.values():
        plain = other.py_func  # type: ignore[attr-defined]
        code = plain.__code__
        h.update(repr((plain.__qualname__, code.co_code, code.co_consts, code.co_names)).encode())
    copied = types.FunctionType(function.__code__, {**function.__globals__, **replaced})
    copied.__qualname__ = f"{function.__name__}_{name}_{h.hexdigest()[:8]}"
    return cast(F, copied)


class _Compilation(event.Listener):
    def on_start(self, event: Any) -> None:
        first_compilation()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]
