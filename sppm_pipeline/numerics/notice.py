"""Who is told when the first kernel is compiled; free of Numba, so that registering costs nothing."""

from __future__ import annotations

from collections.abc import Callable

waiting: list[Callable[[], None]] = []
"""Callbacks that have not been called."""


def on_first_compilation(callback: Callable[[], None]) -> None:
    """Call `callback` once, at the moment when a kernel is not found in the cache and has to be compiled."""
    waiting.append(callback)


def first_compilation() -> None:
    """Call what waits; `sppm_pipeline.numerics.compiled` does so when Numba starts to compile."""
    while waiting:
        waiting.pop(0)()
