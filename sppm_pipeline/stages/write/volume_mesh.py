"""``write.volume_mesh``: tetrahedra for ParaView, Abaqus, CalculiX or Gmsh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.errors import DesignError
from sppm_pipeline.families import options
from sppm_pipeline.families.file_writer import extension_of, require_format, write_pieces
from sppm_pipeline.stage import Context, Stage, option

FORMATS = (".vtu", ".vtk", ".inp", ".msh")

COMMENTS = (
    "coordinates in mm; with forces in N, stresses and moduli are in MPa, densities in t/mm^3",
    "element sets: SOLID, MATERIAL1, ...",
    "node sets: XMIN ... ZMAX whole faces of the box, XMIN_INNER ... without its edges,",
    "YMIN_ZMIN ... edges without corners, XMIN_YMIN_ZMIN ... corners",
)
"""Lines at the top of an .inp file."""


@dataclass(frozen=True, kw_only=True)
class WriteVolumeMesh(Stage):
    """Write a volume mesh; the extension chooses the format: VTU, legacy VTK, Abaqus INP or Gmsh MSH 4.1.

    A .vtu or .vtk file, for ParaView and PyVista, has the cell array ``material``. An .inp file, for Abaqus and
    CalculiX, has elements C3D4 or C3D10, sets of elements, and sets of the nodes in the faces of the box (of the
    bounding box, for a mesh that is no cell), on its edges and at its corners; materials, loads and steps are yours. An
    .msh file has the physical groups ``material1``, ... and the triangles ``XMIN`` ... ``ZMAX`` in the faces of the box
    and ``SURFACE``; of a matched periodic cell the copies of nodes are listed as well. Coordinates are millimeters.
    """

    name: ClassVar[str] = "write.volume_mesh"
    advice: ClassVar[str] = "mesh with a lower `resolution`"

    path: str = options.write_path("mesh.vtu", suffixes=FORMATS)
    compress: bool = option(
        False, help="make a .vtu file smaller; its bytes then depend on the version of the library zlib"
    )
    tie_faces: bool = option(
        False,
        help="tie copies on opposite faces in an .inp file by *EQUATION to three nodes REFX, REFY, REFZ that carry the "
        "mean strain",
        formerly="periodic",
    )

    def check_options(self) -> None:
        require_format(self, self.path, FORMATS, {"compress": ".vtu", "tie_faces": ".inp"})

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return Size(tetrahedra=mesh.tetrahedra, nodes=mesh.nodes, mid_nodes=mesh.mid_nodes)

    @property
    def rated_as(self) -> str:
        return {".vtk": "write.vtu"}.get(extension_of(self.path), f"write{extension_of(self.path)}")

    def run(self, context: Context, mesh: VolumeMesh) -> None:
        """Write the file."""
        encode = {".inp": self._inp, ".msh": self._msh}.get(extension_of(self.path), self._vtk)
        size = write_pieces(context, self.path, encode(mesh))
        context.report(bytes=size, cells=len(mesh.cells), nodes=len(mesh.nodes))

    def _vtk(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import vtu

        if extension_of(self.path) == ".vtk":
            return vtu.encode_legacy(mesh.nodes, mesh.cells, mesh.material_of_cells)
        return vtu.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, self.compress)

    def _inp(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import inp
        from sppm_pipeline.numerics.tetrahedra.node_sets import box_node_sets
        from sppm_pipeline.numerics.tetrahedra.periodic import matched_nodes

        if self.tie_faces and not mesh.matched:
            raise DesignError(
                "opposite faces of this mesh do not match, so that they can't be tied to each other",
                hint="mesh a periodic cell, or leave out `tie_faces`",
            )
        standing = matched_nodes(mesh.nodes, mesh.around) if self.tie_faces else None
        sets = box_node_sets(mesh.nodes, mesh.around)
        return inp.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, sets, standing, COMMENTS)

    def _msh(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import msh
        from sppm_pipeline.numerics.tetrahedra.node_sets import boundary_surfaces, box_copies
        from sppm_pipeline.numerics.tetrahedra.periodic import matched_nodes

        box = mesh.around
        copies = box_copies(mesh.nodes, matched_nodes(mesh.nodes, box), box) if mesh.matched else None
        surfaces = boundary_surfaces(mesh.nodes, mesh.cells, box)
        return msh.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, surfaces, copies)
