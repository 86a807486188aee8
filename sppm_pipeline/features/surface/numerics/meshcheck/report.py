"""The mesh report: topology, orientation, self-intersections and wall thickness of a triangle mesh.

Together they decide whether it bounds a solid that can be made.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.features.surface.numerics.meshcheck.self_intersections import SelfIntersections, self_intersections
from sppm_pipeline.services.mesh.adjacency import (
    BOUNDARY,
    NON_MANIFOLD,
    Adjacency,
    BoundaryLoops,
    adjacency,
    boundary_loops,
)
from sppm_pipeline.services.mesh.box_tree import box_tree
from sppm_pipeline.services.mesh.measures import SurfaceMeasures, measure_surface
from sppm_pipeline.services.mesh.orientation import Orientation, Shells, orient, shells
from sppm_pipeline.services.mesh.rays import WallThickness, wall_thickness


class MeshReport(NamedTuple):
    """The result of `mesh_report`; lengths in the unit of the vertices."""

    measures: SurfaceMeasures
    odd_edges: int  # edges with an odd number of triangles; where there is none, the mesh is watertight
    non_manifold_vertices: int  # vertices with more than one fan of triangles
    # (k,), of each surface connected across edges; None unless closed and oriented (pairs of opposite half-edges)
    genus: NDArray[np.int64] | None
    boundary_loops: BoundaryLoops
    unmerged_vertices: int  # boundary vertices with exactly the coordinates of another one
    duplicates: int  # triangles that name the same corners as an earlier one
    unused_vertices: int
    orientation: Orientation
    shells: Shells | None  # None unless the mesh bounds a solid
    intersections: SelfIntersections
    walls: WallThickness  # of the mesh as it is wound after `orientation`

    @property
    def watertight(self) -> bool:
        """True if no edge is left over when triangles are paired across edges."""
        return self.odd_edges == 0

    @property
    def manifold(self) -> bool:
        """True if no edge has more than two triangles, and no vertex more than one fan of them."""
        return self.measures.edges.non_manifold == 0 and self.non_manifold_vertices == 0

    @property
    def buried(self) -> int:
        """Number of shells wholly within the solid of others; those that overlap are intersections instead."""
        if self.shells is None:
            return 0
        buried = self.shells.buried.copy()
        buried[self.shells.labels[self.intersections.faces]] = False
        return int(buried.sum())

    @property
    def outward(self) -> bool:
        """True if no triangle has to be turned."""
        return self.orientation.turned == 0 and self.orientation.one_sided == 0


def mesh_report(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> MeshReport:
    """Examine a mesh, (n, 3) and (m, 3); ValueError if there is no triangle."""
    points = np.asarray(vertices, np.float64)
    measures = measure_surface(points, faces)
    found = adjacency(faces)
    wound = orient(points, faces)
    tree = box_tree(points[wound.faces])
    return MeshReport(
        measures=measures,
        odd_edges=measures.edges.boundary + _odd(faces, found.opposite),
        non_manifold_vertices=found.non_manifold_vertices,
        genus=_genus(found) if measures.edges.closed else None,
        boundary_loops=boundary_loops(points, faces, found),
        unmerged_vertices=_unmerged(points, faces, found.opposite),
        duplicates=_duplicates(faces, found.opposite),
        unused_vertices=len(points) - measures.vertices,
        orientation=wound,
        shells=shells(points, faces, tree if wound.turned == 0 else None) if measures.edges.bounds_solid else None,
        intersections=self_intersections(tree),
        walls=wall_thickness(tree),
    )


def _edges(faces: NDArray[np.int32], half_edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Lower and higher corner of half-edges, (k, 2)."""
    flat = np.asarray(faces, np.int64).ravel()
    ahead = half_edges - half_edges % 3 + (half_edges + 1) % 3
    return np.sort(np.stack([flat[half_edges], flat[ahead]], axis=1), axis=1)


def _odd(faces: NDArray[np.int32], opposite: NDArray[np.int64]) -> int:
    """Edges of three, five ... triangles."""
    _, counts = np.unique(_edges(faces, np.flatnonzero(opposite == NON_MANIFOLD)), axis=0, return_counts=True)
    return int(np.count_nonzero(counts % 2))


def _genus(found: Adjacency) -> NDArray[np.int64]:
    """Genus of each surface, by its Euler number; a vertex in which surfaces touch belongs to each of them."""
    of_fan = np.zeros(found.fan_count, np.int64)
    of_fan[found.fans] = np.repeat(found.surfaces, 3)
    corners = np.bincount(of_fan, minlength=found.surface_count)
    triangles = np.bincount(found.surfaces, minlength=found.surface_count)
    # three half-edges a triangle, two an edge; the Euler number is 2 - 2 genus
    return np.asarray(1 - (corners - triangles // 2) // 2)


def _unmerged(points: NDArray[np.float64], faces: NDArray[np.int32], opposite: NDArray[np.int64]) -> int:
    """Boundary vertices at the position of another one."""
    on_boundary = points[np.unique(_edges(faces, np.flatnonzero(opposite == BOUNDARY)))]
    return len(on_boundary) - len(np.unique(on_boundary, axis=0))


def _duplicates(faces: NDArray[np.int32], opposite: NDArray[np.int64]) -> int:
    """Triangles with the corners of an earlier one: two share all edges, three make all edges non-manifold."""
    sides = opposite.reshape(-1, 3)
    paired = (sides[:, 0] >= 0) & (sides[:, 0] // 3 == sides[:, 1] // 3) & (sides[:, 1] // 3 == sides[:, 2] // 3)
    suspects = np.sort(faces[paired | (sides == NON_MANIFOLD).any(axis=1)], axis=1)
    return len(suspects) - len(np.unique(suspects, axis=0))
