"""Limits of a run, its end, and native code that may crash, hang or use up all memory.

A segmentation fault can't be caught, an endless loop in C can't be interrupted, and some libraries write into the
current folder or remove Python's signal handlers. `run_native` calls one named function in a fresh interpreter in a
private folder, with a limit of time and of memory, and returns a result that was checked or raises an `SppmError`.

Promised: no pickle is read; the child and all processes that it started are gone when `run_native` returns, raises or
its process dies, even by SIGKILL; the private folder is gone, too, or is removed by a later run. *Not* promised:
protection from malice. The child has the user's rights and may write wherever the user may.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as `typing` has it, which takes longer to load than all that the supervisor needs
if TYPE_CHECKING:
    from sppm_pipeline.engine.process.exchange import ArraySpec, notify
    from sppm_pipeline.engine.process.native import NativeResult, run_native, stop_all

__all__ = ["ArraySpec", "NativeResult", "notify", "run_native", "stop_all"]


def __getattr__(name: str) -> object:
    # lazily, because the process that supervises `sppm run` is forked before NumPy is loaded
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sppm_pipeline.engine.process import exchange, native

    return getattr(exchange if name in ("ArraySpec", "notify") else native, name)
