"""``write.ply``: a triangle mesh as binary PLY, small and exact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WritePly(Stage):
    """Write a triangle mesh as binary PLY, small and exact. Coordinates are millimetres."""

    name: ClassVar[str] = "write.ply"

    path: str = option("mesh.ply", help="file to write")

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file chunk by chunk."""
        from sppm_pipeline.formats import ply

        size = 0
        with context.output(self.path).open("wb") as file:
            for chunk in ply.encode(mesh.vertices, mesh.faces):
                size += file.write(chunk)
        context.report(bytes=size, triangles=len(mesh.faces))
