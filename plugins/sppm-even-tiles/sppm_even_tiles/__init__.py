"""A tile rule for sppm_pipeline: interiors used equally often and never side by side."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {"tile.even_interiors": "sppm_even_tiles.even_interiors:EvenInteriors"}
