"""Tetrahedra: volume meshes that fit the surface, and their homogenization."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sppm_pipeline.hookspecs import hookimpl

if TYPE_CHECKING:
    from sppm_pipeline.stage import StageAlias

STAGES = {
    "read.volume_mesh": "ReadVolumeMesh", "mesh.isosurface_stuffing": "IsosurfaceStuffing", "mesh.boundary": "Boundary",
    "homogenize.tet": "HomogenizeTet", "check.volume_mesh": "CheckVolumeMesh", "write.volume_mesh": "WriteVolumeMesh",
}  # fmt: skip
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


@hookimpl
def sppm_stage_aliases() -> dict[str, StageAlias]:
    """Former names of writers, each of which wrote one format, and keeps it by default."""
    from sppm_pipeline.stage import StageAlias

    return {
        f"write{suffix}": StageAlias.of_format(f"write{suffix}", "write.volume_mesh", f"mesh{suffix}", *also)
        for suffix, also in ((".vtu", (".vtk",)), (".inp", ()), (".msh", ()))
    }
