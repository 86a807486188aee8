"""Tetrahedra: volume meshes that fit the surface, and their homogenization."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sppm_pipeline.hookspecs import hookimpl, stages_in

if TYPE_CHECKING:
    from sppm_pipeline.stage import StageAlias

sppm_stages = stages_in(__name__)


@hookimpl
def sppm_stage_aliases() -> dict[str, StageAlias]:
    """Former names of writers, each of which wrote one format, and keeps it by default."""
    from sppm_pipeline.stage import StageAlias

    return {
        f"write{suffix}": StageAlias.of_format(f"write{suffix}", "write.volume_mesh", f"mesh{suffix}", *also)
        for suffix, also in ((".vtu", (".vtk",)), (".inp", ()), (".msh", ()))
    }
