"""Meshes repaired, remeshed, smoothed and decimated by MeshLab, for sppm_pipeline."""

from __future__ import annotations

from sppm_pipeline import hookimpl

__all__ = ["sppm_stages"]


@hookimpl
def sppm_stages() -> dict[str, str]:
    """Our stages, by the place of their class, which is imported only when it is used."""
    return {
        "mesh.repair": "sppm_pymeshlab.repair:RepairMesh",
        "mesh.remesh": "sppm_pymeshlab.remesh:Remesh",
        "mesh.smooth": "sppm_pymeshlab.smooth:SmoothMesh",
        "mesh.decimate": "sppm_pymeshlab.decimate:DecimateMesh",
    }
