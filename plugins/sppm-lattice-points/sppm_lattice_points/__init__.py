"""A sampler for sppm_pipeline: jittered cubic lattices of pores."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {
        "sample.lattice_points": "sppm_lattice_points.lattice_points:LatticePoints",
    }
