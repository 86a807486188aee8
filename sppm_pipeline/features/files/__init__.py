"""Files: meshes and voxel images, read and written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sppm_pipeline.hookspecs import hookimpl

if TYPE_CHECKING:
    from sppm_pipeline.stage import StageAlias

STAGES = {
    "read.mesh": "ReadMesh",
    "read.voxels": "ReadVoxels",
    "write.mesh": "WriteMesh",
    "write.voxels": "WriteVoxels",
}
"""Stage name -> class; the module is `stages`, with an underscore for the dot."""


@hookimpl
def sppm_stages() -> dict[str, str]:
    """The stages of this feature."""
    return {name: f"{__name__}.stages.{name.replace('.', '_')}:{cls}" for name, cls in STAGES.items()}


@hookimpl
def sppm_stage_aliases() -> dict[str, StageAlias]:
    """Former names of writers, each of which wrote one format, and keeps it by default."""
    from sppm_pipeline.stage import StageAlias

    formats = {"mesh": ".stl .ply .obj .off .3mf .glb", "voxels": ".npy .tiff .vti"}
    return {
        f"write{suffix}": StageAlias.of_format(
            f"write{suffix}", f"write.{noun}", f"{noun}{suffix}", *([".tif"] if suffix == ".tiff" else [])
        )
        for noun, suffixes in formats.items()
        for suffix in suffixes.split()
    }
