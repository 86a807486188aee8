"""``write.msh``: a volume mesh for Gmsh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.families import VolumeMeshWriter
from sppm_pipeline.stage import option


@dataclass(frozen=True, kw_only=True)
class WriteMsh(VolumeMeshWriter):
    """Write a volume mesh as Gmsh's MSH 4.1 (text), with physical groups. Coordinates are millimeters.

    The groups are ``material1``, ... and the triangles ``XMIN`` ... ``ZMAX`` in the faces of the box (of the bounding
    box, for a mesh that is no cell) and ``SURFACE``. Of a matched periodic cell the copies of nodes are listed as well.
    """

    name: ClassVar[str] = "write.msh"

    path: str = option("mesh.msh", help="file to write", output=True)

    def encode(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import msh
        from sppm_pipeline.numerics.tetrahedra.node_sets import boundary_surfaces, box_copies
        from sppm_pipeline.numerics.tetrahedra.periodic import matched_nodes

        box = mesh.around
        copies = box_copies(mesh.nodes, matched_nodes(mesh.nodes, box), box) if mesh.matched else None
        surfaces = boundary_surfaces(mesh.nodes, mesh.cells, box)
        return msh.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, surfaces, copies)
