"""``check.mesh``: the mesh report, and whether the mesh bounds a solid.

The mesh report: topology, orientation, self-intersections and wall thickness of a triangle mesh.

Together they decide whether it bounds a solid that can be made.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from sppm_pipeline import ConfigError, Context, InputError, Length, Rejected, Stage, SurfaceMesh, option
from sppm_pipeline.features.surface.numerics.meshcheck.self_intersections import SelfIntersections, self_intersections
from sppm_pipeline.services.arrays import F64, I32, I64
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
    genus: I64 | None
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


def mesh_report(vertices: F64, faces: I32) -> MeshReport:
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


def _edges(faces: I32, half_edges: I64) -> I64:
    """Lower and higher corner of half-edges, (k, 2)."""
    flat = np.asarray(faces, np.int64).ravel()
    ahead = half_edges - half_edges % 3 + (half_edges + 1) % 3
    return np.sort(np.stack([flat[half_edges], flat[ahead]], axis=1), axis=1)


def _odd(faces: I32, opposite: I64) -> int:
    """Edges of three, five ... triangles."""
    _, counts = np.unique(_edges(faces, np.flatnonzero(opposite == NON_MANIFOLD)), axis=0, return_counts=True)
    return int(np.count_nonzero(counts % 2))


def _genus(found: Adjacency) -> I64:
    """Genus of each surface, by its Euler number; a vertex in which surfaces touch belongs to each of them."""
    of_fan = np.zeros(found.fan_count, np.int64)
    of_fan[found.fans] = np.repeat(found.surfaces, 3)
    corners = np.bincount(of_fan, minlength=found.surface_count)
    triangles = np.bincount(found.surfaces, minlength=found.surface_count)
    # three half-edges a triangle, two an edge; the Euler number is 2 - 2 genus
    return np.asarray(1 - (corners - triangles // 2) // 2)


def _unmerged(points: F64, faces: I32, opposite: I64) -> int:
    """Boundary vertices at the position of another one."""
    on_boundary = points[np.unique(_edges(faces, np.flatnonzero(opposite == BOUNDARY)))]
    return len(on_boundary) - len(np.unique(on_boundary, axis=0))


def _duplicates(faces: I32, opposite: I64) -> int:
    """Triangles with the corners of an earlier one: two share all edges, three make all edges non-manifold."""
    sides = opposite.reshape(-1, 3)
    paired = (sides[:, 0] >= 0) & (sides[:, 0] // 3 == sides[:, 1] // 3) & (sides[:, 1] // 3 == sides[:, 2] // 3)
    suspects = np.sort(faces[paired | (sides == NON_MANIFOLD).any(axis=1)], axis=1)
    return len(suspects) - len(np.unique(suspects, axis=0))


MAX_LISTED = 20
"""Components and holes that are listed one by one, the largest first."""


@dataclass(frozen=True, kw_only=True)
class CheckMesh(Stage):
    """Report how well a mesh bounds a solid; the mesh is passed on as it is.

    Watertight: no edge is left over when triangles are paired across edges. Manifold: no edge has more than two
    triangles, no vertex touches two surfaces. Wound outwards: neighbors agree, and normals point out of the solid.
    Triangles intersect themselves if they cross, touch or overlap another one beyond shared corners and edges.
    The thickness is measured straight inwards from 100,000 points of the surface. To look at a broken file, read it
    with `accept: any`.
    """

    name: ClassVar[str] = "check.mesh"
    reported: ClassVar[tuple[str, ...]] = (
        "triangles", "vertices", "unused_vertices", "watertight", "manifold", "non_manifold_edges",
        "non_manifold_vertices", "winding_consistent", "winding_outward", "triangles_to_turn", "one_sided_surfaces",
        "open_edges", "unmerged_vertices", "holes", "hole_edges.#6", "hole_lengths_mm.#6", "hole_sizes_mm.#6",
        "components", "euler_number", "genus", "degenerate_triangles", "duplicate_triangles",
        "self_intersecting_triangles", "self_intersecting_pairs", "self_intersections_complete", "volume_mm3",
        "area_mm2", "lower_mm.#3", "upper_mm.#3", "genus_of_surfaces.#6", "component_volumes_mm3.#6", "cavities",
        "cavity_mm3", "shells_inside_others", "shells_inside_out", "thickness_minimum_mm", "thickness_5_percent_mm",
        "thickness_median_mm", "thickness_unknown_share", "thin_share",
    )  # fmt: skip
    advice: ClassVar[str] = "extract with a lower `resolution`"

    thin: Length | None = option(None, help="walls thinner than this are thin", unit="mm", above=0, maximum=1e6)
    thin_share: float = option(
        0.01, help="share of the surface from which on thin walls are a problem", minimum=0, maximum=1
    )
    reject: tuple[str, ...] = option(
        (),
        help="problems that end the run; the others are warnings",
        choices=(
            "open", "non_manifold", "winding", "self_intersections", "components", "shells", "degenerate", "duplicates",
            "thin_walls",
        ),
    )  # fmt: skip

    def check_options(self) -> None:
        if "thin_walls" in self.reject and self.thin is None:
            raise ConfigError("`reject: [thin_walls]` needs `thin`, the thickness that a wall must have")

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Measure everything, then say what is wrong."""
        if not len(mesh.faces):
            raise InputError(f"{mesh.name} has no triangles")
        found = mesh_report(mesh.vertices, mesh.faces)
        thin = self.thin.mm() if self.thin is not None else None
        problems = self._problems(found, thin)
        counts = f"{_count(found.measures.components, 'component')}, {_count(found.measures.faces, 'triangle')}"
        if problems:
            verdict = f"{mesh.name} ({counts}) has {_count(len(problems), 'problem')}: {'; '.join(problems.values())}"
        else:
            verdict = f"{mesh.name} ({counts}) bounds a solid: watertight, manifold, wound outwards"
            if thin is not None:
                share = found.walls.share_below(thin)
                verdict += f", {share:.1%} of it" if share else ", none of it"
                verdict += f" with walls thinner than {thin:g} mm"
        context.report(verdict=verdict, problems=list(problems), **_numbers(found, thin))
        for problem in problems.values():
            context.warn(problem)
        if found.shells is not None and found.shells.cavities.any():
            closed = np.abs(found.shells.volumes[found.shells.cavities])
            context.warn(
                f"closed cavities: {len(closed):,}, of "
                f"{closed.sum():.4g} mm3: liquid resin or powder stays inside when {mesh.name} is printed"
            )
        refused = [problems[word] for word in self.reject if word in problems]
        if refused:
            raise Rejected(
                f"{mesh.name} is rejected: {'; '.join(refused)}",
                hint="repair the mesh, or take the word off `reject` in `check.mesh`",
            )
        return mesh

    def _problems(self, found: MeshReport, thin: float | None) -> dict[str, str]:
        """A sentence for each thing that is wrong, by the word that `reject` knows it by."""
        edges, oriented, hit = found.measures.edges, found.orientation, found.intersections
        problems = {}
        if not found.watertight:
            holes = len(found.boundary_loops.edges)
            text = f"it is not watertight: {_count(holes, 'hole')} with {_count(edges.boundary, 'open edge')}"
            if holes:
                text += f", the largest {found.boundary_loops.sizes[0]:.3g} mm wide"
            if found.unmerged_vertices:
                text += f"; {found.unmerged_vertices} vertices there lie on others and were not merged with them"
            problems["open"] = text
        if not found.manifold:
            problems["non_manifold"] = (
                f"it is not manifold: {_count(edges.non_manifold, 'edge')} of three or more triangles, "
                f"{found.non_manifold_vertices} vertices in which surfaces touch"
            )
        if not found.outward:
            text = f"{_count(oriented.turned, 'triangle')} of {found.measures.faces} should be turned to face outwards"
            if oriented.one_sided:
                text += f"; {_count(oriented.one_sided, 'surface')} with one side only, as a Möbius strip has"
            problems["winding"] = text
        if hit.pairs or not hit.complete:
            least = "" if hit.complete else "at least "
            problems["self_intersections"] = (
                f"it runs into itself: {least}{_count(int(hit.faces.sum()), 'triangle')} in {_count(hit.pairs, 'pair')}"
            )
        if found.buried:
            problems["shells"] = (
                f"{_count(found.buried, 'shell')} inside the solid of another, filled with it; "
                "for a hollow its triangles have to face inwards"
            )
        pieces = found.measures.components - (int(found.shells.cavities.sum()) if found.shells else 0)
        if pieces > 1:
            problems["components"] = f"it is in {pieces} pieces"
        if found.measures.degenerate:
            problems["degenerate"] = f"{_count(found.measures.degenerate, 'triangle')} without area"
        if found.duplicates:
            problems["duplicates"] = f"{_count(found.duplicates, 'triangle')} there twice"
        if thin is not None and len(found.walls.thickness):
            share = found.walls.share_below(thin)
            if share > self.thin_share:
                problems["thin_walls"] = (
                    f"{share:.1%} of the surface is on walls thinner than {thin:g} mm; "
                    f"the thinnest 5 % are below {found.walls.quantile(0.05):.3g} mm"
                )
        return problems


def _count(n: int, artifact: str) -> str:
    return f"{n:,} {artifact}{'' if n == 1 else 's'}"


def _numbers(found: MeshReport, thin: float | None) -> dict[str, Any]:
    """All measures under plain names."""
    m, walls = found.measures, found.walls
    numbers: dict[str, Any] = {
        "triangles": m.faces, "vertices": m.vertices, "unused_vertices": found.unused_vertices,
        "watertight": found.watertight, "manifold": found.manifold, "non_manifold_edges": m.edges.non_manifold,
        "non_manifold_vertices": found.non_manifold_vertices, "winding_consistent": m.edges.consistent,
        "winding_outward": found.outward, "triangles_to_turn": found.orientation.turned,
        "one_sided_surfaces": found.orientation.one_sided, "open_edges": m.edges.boundary,
        "unmerged_vertices": found.unmerged_vertices, "holes": len(found.boundary_loops.edges),
        "hole_edges": found.boundary_loops.edges[:MAX_LISTED],
        "hole_lengths_mm": found.boundary_loops.lengths[:MAX_LISTED],
        "hole_sizes_mm": found.boundary_loops.sizes[:MAX_LISTED], "components": m.components, "euler_number": m.euler,
        "genus": None if found.genus is None else int(found.genus.sum()), "degenerate_triangles": m.degenerate,
        "duplicate_triangles": found.duplicates, "self_intersecting_triangles": int(found.intersections.faces.sum()),
        "self_intersecting_pairs": found.intersections.pairs,
        "self_intersections_complete": found.intersections.complete,
        "volume_mm3": m.volume if found.watertight else None, "area_mm2": m.area, "lower_mm": m.low,
        "upper_mm": m.high,
    }  # fmt: skip
    if found.genus is not None:
        numbers["genus_of_surfaces"] = np.sort(found.genus)[::-1][:MAX_LISTED]
    if found.shells is not None:
        volumes = found.shells.volumes
        numbers["component_volumes_mm3"] = volumes[np.argsort(-np.abs(volumes), kind="stable")][:MAX_LISTED]
        numbers["cavities"] = int(found.shells.cavities.sum())
        numbers["cavity_mm3"] = float(np.abs(volumes[found.shells.cavities]).sum())
        numbers["shells_inside_others"] = found.buried
        numbers["shells_inside_out"] = int(found.shells.inside_out.sum())
    if len(walls.thickness):
        numbers["thickness_minimum_mm"] = walls.quantile(0.0)
        numbers["thickness_5_percent_mm"] = walls.quantile(0.05)
        numbers["thickness_median_mm"] = walls.quantile(0.5)
        numbers["thickness_unknown_share"] = float(np.isinf(walls.thickness).mean())
        if thin is not None:
            numbers["thin_share"] = walls.share_below(thin)
    return numbers
