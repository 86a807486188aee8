"""The run record: what was run, with which versions, and what came of it."""

from __future__ import annotations

import datetime
import os
import platform
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import sppm_pipeline
from sppm_pipeline.engine.config.document import RECORD_KEY
from sppm_pipeline.engine.plan.distributions import installed_version
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.errors import SppmError

RECORD_VERSION = 1

_LIBRARIES = ("numpy", "numba", "llvmlite", "scipy", "networkx", "pillow")


def record_of(
    plan: Plan,
    stages: Sequence[Mapping[str, Any]],
    *,
    status: str,
    error: SppmError | None,
    started: datetime.datetime,
    seconds: float,
    threads: int,
    until: str | None,
    extra: Mapping[str, Any],
) -> dict[str, Any]:
    """The record as a dict; `config` comes first so that `sppm run run.json` need not read the rest."""
    plugins = {
        str(step.owner.name): step.owner
        for group in (plan.steps, plan.after, *plan.recipes.values())
        for step in group
        if not step.owner.builtin
    }
    record: dict[str, Any] = {
        RECORD_KEY: RECORD_VERSION,
        "config": plan.document,
        "name": plan.name,
        "status": status,
        "seed": plan.seed,
        "params": dict(plan.params),
        "file": str(plan.configuration.file),
        "until": until,
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(seconds, 6),
        "peak_memory_mb": peak_memory_mb(),
        "threads": threads,
        "versions": {
            "sppm_pipeline": sppm_pipeline.__version__,
            "python": platform.python_version(),
            **_library_versions(),
        },
        "plugins": [
            {"name": name, "distribution": plugin.distribution, "version": plugin.version}
            for name, plugin in plugins.items()
        ],
        "platform": {
            "system": platform.system(),
            "release": platform.release(),
            "machine": platform.machine(),
            "processors": os.cpu_count(),
        },
        "warnings": list(plan.warnings),
        "error": error_entry(error) if error is not None else None,
    }
    return record | dict(extra) | {"stages": list(stages)}


def _library_versions() -> dict[str, str]:
    """Versions of the libraries that results come from; also of those that a run from the cache did not load."""
    found = {name: installed_version(name) for name in _LIBRARIES}
    return {name: version for name, version in found.items() if version is not None}


def error_entry(error: SppmError) -> dict[str, Any]:
    """An error as records and tables hold it."""
    return {
        "kind": type(error).__name__,
        "message": error.message,
        "hint": error.hint,
        "stage": error.stage,
        "where": str(error.where) if error.where else None,
        "exit_code": error.exit_code,
    }


def peak_memory_mb() -> float | None:
    """Largest resident size of this process so far, MB; None where the system does not tell."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3 / 1.024), 1)
