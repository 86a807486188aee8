"""The families of stages as the face has them. Type checkers read ``stages.pyi`` instead, which `sppm stubs` writes."""

from __future__ import annotations

from typing import Any

from sppm_pipeline.engine.api.functions import Family, family_of, step_families
from sppm_pipeline.stage import FAMILIES

CellOptions = dict[str, Any]
"""What `sppm.cell` takes besides; the stub names each."""

step = step_families()


def __getattr__(name: str) -> Family:
    """A family, made when it is first asked for."""
    if name not in FAMILIES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return family_of(name)
