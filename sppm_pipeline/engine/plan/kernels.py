"""Compiled kernels that a plan will call, by a list that comes with the program, and which of them are on the disk.

Numba compiles a function when it is first called. ``kernels.json``, written by ``python -m benchmarks.kernel_list``,
says which stage calls which kernel, and how long compiling takes; by it kernels are compiled ahead, and the time and
memory of compiling are estimated.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.services.jit.kernel_cache import (
    is_kept,
    kernel_cache_lasts,
    on_first_compilation,
    source_of,
)

LIST = Path(__file__).parent / "kernels.json"

SWITCH = "SPPM_COMPILE_AHEAD"
"""Environment variable; ``off`` leaves compiling to the run itself."""

MIN_SECONDS_AHEAD = 3.0
"""Seconds of compiling, by the list, from which it is done by child processes. Starting one takes about half a second,
so at half of this value there is next to nothing to gain."""


_compiled: list[bool] = []
on_first_compilation(lambda: _compiled.append(True))


def has_compiled() -> bool:
    """True if this process has compiled a kernel, which takes memory that later runs do not take."""
    return bool(_compiled)


class Kernel(NamedTuple):
    """A compiled function that Python calls, as the list has it."""

    place: str  # ``package.module:name``
    seconds: float  # CPU time of compiling when the list was made
    stages: tuple[str, ...]  # those that were seen to call it
    company: tuple[str, ...]  # stages that were in every pipeline in which it was called
    signatures: list[Any]  # see `machine_code.signature_as_json`


def listed_kernels() -> list[Kernel]:
    """All kernels of the list, in the order of their use."""
    entries = json.loads(LIST.read_text(encoding="utf-8"))
    return [Kernel(e["kernel"], e["seconds"], tuple(e["stages"]), tuple(e["with"]), e["signatures"]) for e in entries]


def stages_of(plan: Plan) -> set[str]:
    """Names of all stages of a plan, those of its recipes included."""
    return {step.stage.name for steps in (plan.steps, plan.after, *plan.recipes.values()) for step in steps}


def kernels_of(stages: set[str], kernels: Iterable[Kernel]) -> list[Kernel]:
    """Those that a pipeline of these stages will probably call."""
    return [k for k in kernels if stages.issuperset(k.company) and not stages.isdisjoint(k.stages)]


def missing(kernels: Iterable[Kernel]) -> list[Kernel]:
    """Those that have to be compiled; none if nothing can be kept on the disk, or installed machine code fits.

    That was made of the same sources by running more than the list is of; the few kernels of an edited module are
    compiled when they are called.
    """
    from sppm_pipeline.services.jit.machine_code import is_shipped

    wanted = list(kernels) if kernel_cache_lasts() else []
    if any(is_shipped(*source_of(kernel.place), kinds) for kernel in wanted for kinds in kernel.signatures):
        return []
    return [kernel for kernel in wanted if not is_kept(kernel.place, len(kernel.signatures))]


def missing_of(plan: Plan) -> list[Kernel]:
    """Kernels that a plan will probably call and that have to be compiled."""
    return missing(kernels_of(stages_of(plan), listed_kernels()))
