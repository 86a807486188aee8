"""STEP and IGES files for sppm_pipeline, by Open CASCADE."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stage, by the place of its class, which is imported only when it is used."""
    return {"read.cad": "sppm_cad.read_cad:ReadCad"}
