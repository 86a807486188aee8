"""``read.hexahedra``: the surface of a mesh of hexahedra, as the part that its cells fill."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from sppm_pipeline import Context, Palette, Size, Stage, SurfaceMesh, option, options
from sppm_pipeline.features.grading.hexahedra import check_path, mesh_of, size_of_mesh
from sppm_pipeline.features.grading.numerics.hexahedral_mesh import boundary_triangles
from sppm_pipeline.nouns.size import Geometry
from sppm_pipeline.services.formats.hexahedra_file import read_hexahedra


@dataclass(frozen=True, kw_only=True)
class ReadHexahedra(Stage):
    """Read a mesh of hexahedra from a VTU, VTK, Abaqus INP or Gmsh MSH file, and take the surface at which it ends.

    It is the part that `tile.hexahedra` and `warp.hexahedra` fill: give it to `fill.implicit` as the domain. The mesh
    is checked: elements meet face to face, none is flat, inside out or listed twice. Nodes at the same place are taken
    as one, and nodes that are numbered in another order than VTK's are put in order with a warning. The reader is
    the library meshio.
    """

    name: ClassVar[str] = "read.hexahedra"
    libraries: ClassVar[tuple[str, ...]] = ("meshio",)
    reported: ClassVar[tuple[str, ...]] = ("hexahedra",)

    path: Path = options.read_path(note="a mesh of hexahedra: .vtu, .vtk, .inp or .msh")
    unit: str = options.unit("mm", note="of the nodes")
    squares: int = option(
        4, help="squares along each edge of a face, by which faces that are twisted are followed", minimum=1, maximum=64
    )

    def check_options(self) -> None:
        check_path(self.path)

    def estimate(self, palette: Palette) -> Size:
        mesh = size_of_mesh(self.path, self.unit)
        part = Geometry(edge_mm=1.0, box=mesh.box, volume=mesh.volume, envelope=mesh.area)
        return Size(cells=mesh.hexahedra, triangles=2.0 * self.squares**2 * mesh.faces, geometry=part)

    def run(self, context: Context) -> SurfaceMesh:
        """Read, check, and cut the faces into triangles."""
        mesh = mesh_of(read_hexahedra(self.path), self.path, self.unit, context)
        context.report(hexahedra=len(mesh.corners))
        return SurfaceMesh(*boundary_triangles(mesh, self.squares), name=self.path.name)
