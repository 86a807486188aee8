"""3MF slice stacks by lib3mf, for sppm_pipeline."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stage, by the place of its class, which is imported only when it is used."""
    return {"write.3mf_slices": "sppm_lib3mf.slices:WriteSlices"}
