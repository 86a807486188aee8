"""``mesh.decimate``: fewer triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Stage, SurfaceMesh, option, options
from sppm_pymeshlab.meshlab import compared, worked


@dataclass(frozen=True, kw_only=True)
class DecimateMesh(Stage):
    """Lower the number of triangles (quadric edge collapse, Garland and Heckbert 1997).

    Edges whose collapse changes the surface least go first; collapses that would change the topology are left out, so
    a closed mesh stays closed, and in rare cases more triangles remain than requested. MeshLab runs in a child process.
    """

    name: ClassVar[str] = "mesh.decimate"

    triangles: int | None = option(None, help="triangles that remain", minimum=4, formerly="faces")
    keep: float | None = option(
        None, help="triangles that remain, as a fraction of those there are", above=0, below=1, formerly="share"
    )
    time_limit: float = options.time_limit(600.0)

    def check_options(self) -> None:
        if (self.triangles is None) == (self.keep is None):
            raise ConfigError("give either `triangles` or `keep`", hint="for example `keep: 0.5`")

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Decimate, and report volumes."""
        target = self.triangles if self.triangles is not None else max(4, round((self.keep or 0) * len(mesh.faces)))
        if target >= len(mesh.faces):
            context.warn(f"{mesh.name} has only {len(mesh.faces)} triangles; it stays as it is")
            compared(context, mesh, mesh)
            return mesh
        made = worked(context, mesh, "decimate", self.time_limit, faces=target)
        if len(made.faces) > 1.05 * target + 4:
            context.warn(f"{len(made.faces)} triangles remain, the target is {target}: fewer would change the topology")
        return made
