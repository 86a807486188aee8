"""``write.glb``: a triangle mesh as binary glTF, for viewers and web pages."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.mesh import RepeatedMesh, SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.families.mesh_writer import ADVICE, write_mesh, written
from sppm_pipeline.stage import Context, Stage, option


@dataclass(frozen=True, kw_only=True)
class WriteGlb(Stage):
    """Write a triangle mesh as binary glTF 2.0, for viewers and web pages; in metres and with y up, as it must be.

    What `extract.unit_cell` makes is written once and placed by a node for each cell.
    """

    name: ClassVar[str] = "write.glb"
    advice: ClassVar[str] = ADVICE

    path: str = option("mesh.glb", help="file to write", output=True)
    normals: bool = option(False, help="whether each vertex gets a normal, so that viewers shade smoothly")

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return written(mesh)

    @property
    def rated_as(self) -> str:
        return f"{self.name}.normals" if self.normals else self.name

    def run(self, context: Context, mesh: SurfaceMesh | RepeatedMesh) -> None:
        """Write the file."""
        from sppm_pipeline.formats.glb_encode import encode

        write_mesh(context, self.path, mesh, encode, normals=self.normals)
