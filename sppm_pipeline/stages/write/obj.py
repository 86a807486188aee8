"""``write.obj``: a triangle mesh as Wavefront OBJ, a text that every program reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WriteObj(Stage):
    """Write a triangle mesh as Wavefront OBJ, a text that every program reads. Coordinates are millimetres."""

    name: ClassVar[str] = "write.obj"

    path: str = option("mesh.obj", help="file to write")

    def run(self, context: Context, mesh: SurfaceMesh) -> None:
        """Write the file chunk by chunk."""
        from sppm_pipeline.formats import obj

        size = 0
        with context.output(self.path).open("wb") as file:
            for chunk in obj.encode(mesh.vertices, mesh.faces):
                size += file.write(chunk)
        context.report(bytes=size, triangles=len(mesh.faces))
