"""3MF slice stacks and beam lattices by lib3mf, for sppm_pipeline."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the places of their classes, which are imported only when they are used."""
    return {"write.3mf_beams": "sppm_lib3mf.beams:WriteBeams", "write.3mf_slices": "sppm_lib3mf.slices:WriteSlices"}
