"""``write.inp``: a volume mesh for Abaqus and CalculiX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.data.volume_mesh import VolumeMesh
from sppm_pipeline.errors import DesignError
from sppm_pipeline.families import VolumeMeshWriter
from sppm_pipeline.stage import option

COMMENTS = (
    "coordinates in mm; with forces in N, stresses and moduli are in MPa, densities in t/mm^3",
    "element sets: SOLID, MATERIAL1, ...",
    "node sets: XMIN ... ZMAX whole faces of the box, XMIN_INNER ... without its edges,",
    "YMIN_ZMIN ... edges without corners, XMIN_YMIN_ZMIN ... corners",
)


@dataclass(frozen=True, kw_only=True)
class WriteInp(VolumeMeshWriter):
    """Write a volume mesh as input for Abaqus or CalculiX: elements C3D4 or C3D10, sets of elements and of nodes.

    There are sets of the nodes in the six faces of the box (of the bounding box, for a mesh that is no cell), on its
    edges and at its corners. Materials, loads and steps are yours. Coordinates are millimeters.
    """

    name: ClassVar[str] = "write.inp"

    path: str = option("mesh.inp", help="file to write", output=True)
    periodic: bool = option(
        False,
        help="tie copies on opposite faces by *EQUATION to three nodes REFX, REFY, REFZ that carry the mean strain",
    )

    def encode(self, mesh: VolumeMesh) -> Iterator[bytes]:
        from sppm_pipeline.formats import inp
        from sppm_pipeline.numerics.tetrahedra.node_sets import box_node_sets
        from sppm_pipeline.numerics.tetrahedra.periodic import matched_nodes

        if self.periodic and not mesh.matched:
            raise DesignError(
                "opposite faces of this mesh do not match, so that they can't be tied to each other",
                hint="mesh a periodic cell, or leave out `periodic`",
            )
        standing = matched_nodes(mesh.nodes, mesh.around) if self.periodic else None
        sets = box_node_sets(mesh.nodes, mesh.around)
        return inp.encode(mesh.nodes, mesh.cells, mesh.material_of_cells, sets, standing, COMMENTS)
