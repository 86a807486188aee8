"""Surfaces: meshes extracted from fields, checked, and combined."""

from __future__ import annotations

from sppm_pipeline.hookspecs import hookimpl

STAGES = {
    "fill.boolean": "BooleanFill",
    "fill.combine": "Combine",
    "extract.marching_cubes": "MarchingCubes",
    "extract.unit_cell": "UnitCell",
    "extract.manifold_sdf": "ManifoldSdf",
    "mesh.simplify": "SimplifyMesh",
    "check.mesh": "CheckMesh",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}
