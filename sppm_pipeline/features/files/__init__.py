"""Files: meshes and voxel images, read and written."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sppm_pipeline.hookspecs import hookimpl, stages_in

if TYPE_CHECKING:
    from sppm_pipeline.stage import StageAlias

sppm_stages = stages_in(__name__)
GROUPS = {"": "everyday"}


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
