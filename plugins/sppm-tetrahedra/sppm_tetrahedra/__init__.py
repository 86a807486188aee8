"""Tetrahedra: volume meshes that fit the surface, and their homogenization.

What its stages pass on, `VolumeMesh`, is loaded when it is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sppm_pipeline import hookimpl
from sppm_pipeline.nouns import stages_in

if TYPE_CHECKING:
    from sppm_pipeline.nouns import StageAlias
    from sppm_tetrahedra.volume_mesh import VolumeMesh

__all__ = ["VolumeMesh", "sppm_stage_aliases", "sppm_stages"]

SPPM_API_VERSION = 1  # a program where `sppm_pipeline.API` is another number refuses this plugin

sppm_stages = stages_in(__name__)


@hookimpl
def sppm_stage_aliases() -> dict[str, StageAlias]:
    """Former names of writers, each of which wrote one format, and keeps it by default."""
    from sppm_pipeline.nouns import StageAlias

    return {
        f"write{suffix}": StageAlias.of_format(f"write{suffix}", "write.volume_mesh", f"mesh{suffix}", *also)
        for suffix, also in ((".vtu", (".vtk",)), (".inp", ()), (".msh", ()))
    }


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sppm_tetrahedra import volume_mesh

    return getattr(volume_mesh, name)
