"""How kernels are compiled: one decorator, so that every kernel is cached on disk and releases the GIL.

Kernels are compiled on their first call, not on import, and the machine code is kept in Numba's cache; a caller
that wants to tell its user about the wait registers a callback with `on_first_compilation`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba.core import event

F = TypeVar("F", bound=Callable[..., Any])

__all__ = ["inline_kernel", "kernel", "on_first_compilation"]


def kernel(function: F) -> F:
    """Compile `function` on first call with strict IEEE arithmetic, no GIL, cached on disk."""
    return numba.njit(cache=True, nogil=True, error_model="numpy")(function)  # type: ignore[no-any-return]


def inline_kernel(function: F) -> F:
    """Compile `function` with reassociation and contraction allowed, for inner loops over contiguous rows.

    Only the flags that let LLVM vectorise are set: NaN and infinity keep their meaning.
    """
    flags = {"reassoc", "contract", "arcp", "nsz"}
    return numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=flags)(function)  # type: ignore[no-any-return]


class _FirstCompilation(event.Listener):  # type: ignore[misc]
    def __init__(self, callback: Callable[[], None]) -> None:
        self._callback: Callable[[], None] | None = callback

    def on_start(self, event: Any) -> None:
        if self._callback is not None:
            callback, self._callback = self._callback, None
            callback()

    def on_end(self, event: Any) -> None:
        pass


def on_first_compilation(callback: Callable[[], None]) -> None:
    """Call `callback` once, at the moment when a kernel is not found in the cache and has to be compiled."""
    event.register("numba:compile", _FirstCompilation(callback))
