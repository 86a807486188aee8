"""``mesh.simplify``: fewer triangles within a distance of the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import Context, DesignError, Headline, InputError, Length, Palette, Size, Stage, SurfaceMesh, option

KEPT_SHARE = 0.25
"""Triangles that remain of a mesh of cubes, for the estimate: 0.15 to 0.4 at a fifth of a voxel."""


@dataclass(frozen=True, kw_only=True)
class SimplifyMesh(Stage):
    """Collapse edges as long as the surface stays within a distance of the one given, and keeps its topology.

    All vertices, and the middles of all triangles, lie within `largest_distance` of the surface given, as the mesh
    holds it; how far that is from the field it was extracted from is a matter of the voxels. Flat triangles of low
    quality go as far as they can. Vertices at open boundaries and where surfaces touch stay where they are. Euler
    number, closedness and volume are compared with those before, and a mesh that differs is refused. Groups of
    triangles are dissolved.
    """

    name: ClassVar[str] = "mesh.simplify"
    reported: ClassVar[tuple[str, ...]] = (
        "triangles_before", "triangles_after", "farthest_mm", "volume_change", "flat_share_before", "flat_share_after",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("triangles_before", "triangles before"), Headline("triangles_after", "after"),
        Headline("farthest_mm", "farthest", "mm"),
    )  # fmt: skip
    advice: ClassVar[str] = "extract with a lower `resolution`"

    largest_distance: Length = option(
        Length(0.02, "mm"), help="largest distance of vertices and middles of triangles from the surface given",
        unit="mm", above=0, maximum=1e3,
    )  # fmt: skip

    def estimate(self, palette: Palette, mesh: Size) -> Size:
        return Size(triangles=KEPT_SHARE * mesh.triangles, geometry=mesh.geometry)

    def run(self, context: Context, mesh: SurfaceMesh) -> SurfaceMesh:
        """Simplify, then compare with the mesh before."""
        from sppm_pipeline.features.surface.numerics.simplifying import FLATTEST, qualities, simplify
        from sppm_pipeline.services.mesh.measures import edge_counts, euler_number, surface_area, volume

        if not len(mesh.faces):
            raise InputError(f"{mesh.name} has no triangles")
        tolerance = self.largest_distance.mm()
        made = simplify(mesh.vertices, mesh.faces, tolerance)
        before, after = edge_counts(mesh.faces), edge_counts(made.faces)
        euler = euler_number(mesh.faces), euler_number(made.faces)
        was, now = volume(mesh.vertices, mesh.faces), volume(made.vertices, made.faces)
        moved = tolerance * surface_area(mesh.vertices, mesh.faces)
        if euler[0] != euler[1] or before.closed != after.closed or before.boundary != after.boundary:
            raise DesignError(
                f"the topology of {mesh.name} would change: Euler number {euler[0]} before, {euler[1]} after",
                hint="repair the mesh first, or leave `mesh.simplify` out",
            )
        if abs(now - was) > moved:
            raise DesignError(
                f"the volume of {mesh.name} would change from {was:g} to {now:g} mm3, more than its surface can within "
                f"{tolerance:g} mm",
                hint="give a smaller `largest_distance`",
            )
        flat = (float((qualities(*arrays) < FLATTEST).mean()) for arrays in ((mesh.vertices, mesh.faces), made[:2]))
        context.report(
            triangles_before=len(mesh.faces), triangles_after=len(made.faces), farthest_mm=made.farthest,
            volume_change=now / was - 1 if was else 0.0, flat_share_before=next(flat), flat_share_after=next(flat),
        )  # fmt: skip
        return SurfaceMesh(made.vertices, made.faces, mesh.name)
