"""``check.volume_mesh``: whether a volume mesh is fit for finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, Rejected, Stage, option, options
from sppm_tetrahedra.volume_mesh import VolumeMesh, face_match, matched_nodes

BINS = 18
"""Intervals of the reported histogram of dihedral angles, of ten degrees each."""


@dataclass(frozen=True, kw_only=True)
class CheckVolumeMesh(Stage):
    """Report the shape of the cells and how they fit together; reject a mesh unfit for finite elements.

    Rejected are cells without positive volume (for quadratic ones: without positive Jacobian at a node), faces of
    three or more cells, a boundary that does not close, opposite faces of a matched cell that differ, and dihedral
    angles below the limit.
    """

    name: ClassVar[str] = "check.volume_mesh"
    reported: ClassVar[tuple[str, ...]] = (
        "minimum_dihedral_degrees", "maximum_dihedral_degrees", "maximum_radius_ratio", "maximum_edge_ratio",
        "minimum_volume_mm3", "inverted", "folded", "non_manifold_faces", "boundary_closed", "non_manifold_edges",
        "unused_nodes", "matched_triangles.#3", "free_triangles.#3", "mismatched_triangles.#3", "components",
    )  # fmt: skip

    minimum_angle: float = option(
        5.0, help="smallest dihedral angle that is accepted", unit="degrees", minimum=0, below=70,
        formerly="least_angle",
    )  # fmt: skip
    one_piece: bool = option(False, help="reject a mesh with several components, which share no face")
    accept: str = options.accept(
        "sound", note="sound: reject a mesh with faults; any: only report them", choices=("sound", "any")
    )

    def run(self, context: Context, mesh: VolumeMesh) -> VolumeMesh:
        """Measure, and pass the mesh on."""
        from sppm_pipeline.numerics import mesh_edges
        from sppm_tetrahedra.numerics import faces
        from sppm_tetrahedra.numerics.quality import dihedral_histogram, minimum_jacobian, quality

        if not len(mesh.cells):
            raise Rejected("the mesh has no cells")
        faults: list[str] = []
        shape = quality(mesh.nodes, mesh.cells)
        context.report(
            cells=len(mesh.cells), nodes=len(mesh.nodes), volume_mm3=shape.volume,
            minimum_dihedral_degrees=shape.minimum_dihedral, maximum_dihedral_degrees=shape.maximum_dihedral,
            maximum_radius_ratio=shape.radius_ratio, maximum_edge_ratio=shape.edge_ratio,
            minimum_volume_mm3=shape.minimum_volume, inverted=shape.inverted,
            dihedral_histogram=dihedral_histogram(mesh.nodes, mesh.cells, BINS).tolist(),
        )  # fmt: skip
        if shape.inverted:
            faults.append(f"{shape.inverted} cells have no positive volume")
        elif shape.minimum_dihedral < self.minimum_angle:
            faults.append(
                f"the smallest dihedral angle is {shape.minimum_dihedral:.3g} degrees, below {self.minimum_angle:g}"
            )
        if mesh.cells.shape[1] == 10:
            folded = int((minimum_jacobian(mesh.nodes, mesh.cells) <= 0).sum())
            context.report(folded=folded)
            if folded and not shape.inverted:
                faults.append(f"{folded} quadratic cells have no positive Jacobian at one of their nodes")
        neighbors = faces.face_neighbors(mesh.cells)
        shared = int((neighbors == faces.NON_MANIFOLD).sum())
        edges = mesh_edges(faces.boundary_triangles(mesh.cells, neighbors))
        unused = len(mesh.nodes) - len(np.unique(mesh.cells))
        context.report(
            non_manifold_faces=shared, boundary_closed=edges.bounds_solid, non_manifold_edges=edges.non_manifold,
            unused_nodes=unused,
        )  # fmt: skip
        if shared:
            faults.append(f"{shared} faces of cells are shared by three or more")
        elif not edges.bounds_solid:
            faults.append(f"the boundary does not close: {edges.unbalanced} edges have no partner")
        joined: NDArray[np.integer] = mesh.cells[:, :4]
        if mesh.matched and mesh.box is not None:
            match = face_match(mesh.nodes, mesh.cells, mesh.box)
            context.report(
                matched_triangles=match.matched.tolist(),
                free_triangles=match.free.tolist(),
                mismatched_triangles=match.mismatched.tolist(),
            )
            if match.mismatched.any():
                faults.append(
                    f"{match.mismatched.sum()} triangles in opposite faces of the box are no copies of each other"
                )
            else:
                joined = matched_nodes(mesh.nodes, mesh.box)[joined]
        parts = faces.components(faces.face_neighbors(joined))[0]
        context.report(components=parts)
        if self.one_piece and parts > 1:
            faults.append(f"the mesh has {parts} components, which share no face")
        if faults and self.accept == "sound":
            raise Rejected("; ".join(faults), hint="`accept: any` only reports")
        for fault in faults:
            context.warn(fault)
        return mesh
