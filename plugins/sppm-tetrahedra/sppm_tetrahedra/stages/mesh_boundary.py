"""``mesh.boundary``: the surface of a volume mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, Palette, Size, Stage, SurfaceMesh
from sppm_tetrahedra.volume_mesh import VolumeMesh


@dataclass(frozen=True, kw_only=True)
class Boundary(Stage):
    """Take the triangles at which a volume mesh ends, to look at them, to check them or to print them.

    The faces of the box of a cell are part of it. Of quadratic cells the corners are taken.
    """

    name: ClassVar[str] = "mesh.boundary"
    reported: ClassVar[tuple[str, ...]] = ("closed", "non_manifold_edges")
    advice: ClassVar[str] = "mesh with a lower `resolution`"

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return Size(triangles=mesh.triangles, tetrahedra=mesh.tetrahedra, geometry=mesh.geometry)

    def run(self, context: Context, mesh: VolumeMesh) -> SurfaceMesh:
        """Find the faces with a cell on one side only."""
        import numpy as np

        from sppm_pipeline.numerics import mesh_edges
        from sppm_tetrahedra.numerics.faces import boundary_triangles, face_neighbors

        triangles = boundary_triangles(mesh.cells, face_neighbors(mesh.cells))
        used, corners = np.unique(triangles, return_inverse=True)
        faces = corners.reshape(-1, 3).astype(np.int32)
        counts = mesh_edges(faces)
        context.report(closed=counts.bounds_solid, non_manifold_edges=counts.non_manifold)
        return SurfaceMesh(mesh.nodes[used], faces, name=f"surface of the {mesh.name}")
