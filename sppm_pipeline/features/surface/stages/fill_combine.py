"""``fill.combine``: plates, handles and screw holes, added to a mesh or cut out of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, Length, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.engine.process.budget import child_memory, require_memory
from sppm_pipeline.features.surface.solids import ManifoldLimits, check_solid, manifold_combine
from sppm_pipeline.features.surface.stages.fill_boolean import BOOLEAN_BYTES

ZERO = Length(0.0)


@dataclass(frozen=True, kw_only=True)
class Combine(Stage):
    """Unite a mesh with another one, the tool, cut the tool out of it, or keep what both have in common.

    The tool is first scaled, then turned about the axes through the origin, then moved. With several places it is set
    down at each of them: four screw holes are one cylinder at four places. Both meshes must be closed.
    """

    name: ClassVar[str] = "fill.combine"
    libraries: ClassVar[tuple[str, ...]] = ("manifold3d",)
    advice: ClassVar[str] = "give meshes with fewer triangles"

    operation: str = option(
        help="union: mesh and tool; difference: mesh without tool; intersection: what both have in common",
        choices=("union", "difference", "intersection"),
    )
    scale: float = options.scale(1.0, note="of the tool", above=0)
    turn: tuple[float, float, float] = options.turn((0.0, 0.0, 0.0), note="of the tool")
    at: tuple[tuple[Length, Length, Length], ...] = option(
        ((ZERO, ZERO, ZERO),),
        help="where copies of the tool go: how far each is moved along x, y, z",
        unit="mm",
        minimum=-1e9,
        maximum=1e9,
    )
    time_limit: float = options.time_limit(600.0, note="there is one, in which they are combined")

    def check_options(self) -> None:
        if not self.at:
            raise ConfigError("`at` names no place for the tool", hint="leave it out to take the tool where it is")

    def estimate(self, palette: Palette, mesh: Size, tool: Size) -> Size:
        # as much as can be: how much of the tool lies within the mesh is unknown; each copy meets all united before
        copies, whole, part = len(self.at), mesh.body.in_unit(1.0), tool.body.in_unit(1 / self.scale)
        added = copies * part.volume if self.operation == "union" else 0.0
        made = replace(whole, volume=whole.volume + added, envelope=whole.envelope + copies * part.envelope)
        return Size(triangles=mesh.triangles + copies * (copies + 1) / 2 * tool.triangles, geometry=made)

    def run(self, context: Context, mesh: SurfaceMesh, tool: SurfaceMesh) -> SurfaceMesh:
        """Place the copies of the tool, unite them, and combine."""
        from sppm_pipeline.services.mesh.measures import volume
        from sppm_pipeline.services.mesh.rotation import rotated, rotation

        check_solid(mesh.vertices, mesh.faces, mesh.name)
        check_solid(tool.vertices, tool.faces, tool.name)
        triangles = len(mesh.faces) + len(self.at) * len(tool.faces)
        require_memory(
            triangles * BOOLEAN_BYTES,
            f"a Boolean of {triangles} triangles",
            "give meshes with fewer triangles",
            limit=context.memory_limit,
        )
        turned = rotated(tool.vertices * self.scale, rotation(self.turn))
        made = manifold_combine(
            (mesh.vertices, mesh.faces),
            (turned, tool.faces),
            self.operation,
            (mesh.name, tool.name),
            ManifoldLimits(self.time_limit, child_memory(context.memory_limit), context.progress),
            places=[np.array([length.mm() for length in place]) for place in self.at],
        )
        context.report(mesh_mm3=volume(mesh.vertices, mesh.faces), tool_mm3=made.tool_volume)
        return SurfaceMesh(*made.mesh, name=mesh.name)
