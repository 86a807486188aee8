"""``mesh.decimate``: fewer triangles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Stage, SurfaceMesh, option
from sppm_pymeshlab.meshlab import compared, worked


@dataclass(frozen=True, kw_only=True)
class DecimateMesh(Stage):
    """Lower the number of triangles (quadric edge collapse, Garland and Heckbert 1997).

    Edges whose collapse changes the surface least go first; collapses that would change the topology are left out, so
    a closed mesh stays closed, and in rare cases more triangles remain than requested. MeshLab runs in a child process.
    """

    name: ClassVar[str] = "mesh.decimate"

    faces: int | None = option(None, help="triangles that remain", minimum=4)
    share: float | None = option(None, help="triangles that remain, as a share of those there are", above=0, below=1)
    time_limit: float = option(600.0, help="the child process is ended after this time", unit="s", above=0)

    def check_options(self) -> None:
        if (self.faces is None) == (self.share is None):
            raise ConfigError("give either `faces` or `share`", hint="for example `share: 0.5`")

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Decimate, and report volumes."""
        target = self.faces if self.faces is not None else max(4, round((self.share or 0) * len(mesh.faces)))
        if target >= len(mesh.faces):
            context.warn(f"{mesh.name} has only {len(mesh.faces)} triangles; it stays as it is")
            compared(context, mesh, mesh)
            return mesh
        made = worked(context, mesh, "decimate", self.time_limit, faces=target)
        if len(made.faces) > 1.05 * target + 4:
            context.warn(
                f"{len(made.faces)} triangles remain, not {target} as requested: fewer would change the topology"
            )
        return made
