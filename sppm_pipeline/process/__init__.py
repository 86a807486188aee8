"""Running native code that may crash, hang or eat the machine: in a child process, with limits, and never in ours.

A segmentation fault can't be caught, an endless loop in C can't be interrupted, and some libraries write into the
current folder or remove Python's signal handlers. `run_native` calls one named function in a fresh interpreter in a
private folder, with a limit of time and of memory, and turns whatever becomes of it into a result that was checked or
into one of our errors.

Promised: no pickle is read; the child and all processes that it started are gone when `run_native` returns, raises or
its process dies, even by SIGKILL; the private folder goes with them, or is removed by a later run. *Not* promised:
protection from malice. The child has the user's rights and may write wherever the user may.
"""

from sppm_pipeline.process.arrays import ArraySpec
from sppm_pipeline.process.run import NativeResult, run_native, stop_all
from sppm_pipeline.process.telling import tell

__all__ = ["ArraySpec", "NativeResult", "run_native", "stop_all", "tell"]
