"""How kernels are compiled: one decorator, so that every kernel is cached on disk and releases the GIL.

Kernels are compiled on their first call, not on import, and the machine code is kept in Numba's cache; a caller
that wants to tell its user about the wait registers a callback with `sppm_pipeline.numerics.notice`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import config, event

from sppm_pipeline.numerics.kernel_cache import kernel_cache_folder
from sppm_pipeline.numerics.notice import first_compilation


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


def _compiled(function: F, fastmath: set[str] | bool) -> F:
    # Numba asks for the folder when it wraps a function, and declares its settings at run time
    setattr(config, "CACHE_DIR", str(kernel_cache_folder(function.__code__.co_filename)))  # noqa: B010
    wrapped: Any = numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=fastmath)(function)
    return wrapped  # type: ignore[no-any-return]


class _Compilation(event.Listener):
    def on_start(self, event: Any) -> None:
        first_compilation()

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Compilation())  # type: ignore[no-untyped-call]
