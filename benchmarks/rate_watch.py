"""What a stage takes while a pipeline runs: processor time without its recipe's, the peak of memory, what it keeps."""

from __future__ import annotations

import ctypes
import gc
import os
import resource
import threading
import time
from pathlib import Path
from typing import Any


class Watch:
    """Measures each stage of a run that is no part of a recipe."""

    def __init__(self) -> None:
        self.found: dict[str, dict[str, float]] = {}
        self.base = 0.0
        self._inner: list[float] = []
        self._children = 0.0
        self._libc = ctypes.CDLL(None)
        threading.Thread(target=self._watch_children, daemon=True).start()

    def around(self, *modules: Any) -> None:
        """Measure what the function that runs a stage does, in all modules that call it."""
        run_step = modules[0].run_step

        def measured(step: Any, stage: Any, inputs: Any, *rest: Any) -> Any:
            outer = not self._inner
            if outer:
                gc.collect()
                self._libc.malloc_trim(0)
                Path("/proc/self/clear_refs").write_text("5")
                before, self._children = memory("VmRSS"), 0.0
                self.base = self.base or before
            self._inner.append(0.0)
            started = processor_time()
            made = run_step(step, stage, inputs, *rest)
            took = processor_time() - started
            own = took - self._inner.pop()
            if not outer:
                self._inner[-1] += took
                return made
            peak = memory("VmHWM") - before + self._children
            self.found[step.id] = {"seconds": own, "memory": peak, "kept": kept(made, inputs)}
            return made

        for module in modules:
            module.run_step = measured

    def _watch_children(self) -> None:
        while True:
            self._children = max(self._children, held_by_children("self"))
            time.sleep(0.01)


def held_by_children(process: str) -> float:
    """Bytes resident in all processes that descend from one."""
    total = 0.0
    try:
        for task in Path(f"/proc/{process}/task").iterdir():
            for child in (task / "children").read_text().split():
                pages = int(Path(f"/proc/{child}/statm").read_text().split()[1])
                total += pages * os.sysconf("SC_PAGE_SIZE") + held_by_children(child)
    except (OSError, IndexError):  # it has ended
        pass
    return total


def processor_time() -> float:
    """Seconds of this process and of the child processes that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def memory(what: str) -> float:
    """Bytes resident now, or at most since the last reset."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024.0 * next(int(line.split()[1]) for line in lines if line.startswith(what))


def kept(made: Any, inputs: dict[str, Any]) -> float:
    """Bytes of an artifact without those of artifacts that it refers to."""
    from sppm_pipeline.method.fields.scalar_field import ScalarField
    from sppm_pipeline.method.slicing.slice_stack import SliceStack
    from sppm_pipeline.nouns.storage import NotStorable, stored_bytes

    if made is None or any(made is given for given in inputs.values()):
        return 0.0
    try:
        refers = isinstance(made, (ScalarField, SliceStack))
        others = [stored_bytes(given) for given in inputs.values() if given is not None and refers]
        return max(0.0, float(stored_bytes(made) - sum(others)))
    except NotStorable:
        return 0.0
