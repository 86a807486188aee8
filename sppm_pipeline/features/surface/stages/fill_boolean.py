"""``fill.boolean``: microstructure AND part, as a Boolean of two meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sppm_pipeline import Length, Palette, Part, ScalarField, Size, SurfaceMesh, options
from sppm_pipeline.engine.process.budget import child_memory, require_memory
from sppm_pipeline.errors import ConfigError, DesignError, InputError
from sppm_pipeline.features.surface.field_surface import (
    MAX_VOXELS,
    MIN_VOXELS,
    FieldSurface,
    expected_voxels,
    voxels_along_edge,
)
from sppm_pipeline.features.surface.solids import ManifoldLimits, check_solid, manifold_combine
from sppm_pipeline.method.part.part import node_grid
from sppm_pipeline.services.arrays import F64, I32
from sppm_pipeline.stage import Context, Stage

BOOLEAN_BYTES = 600
"""Bytes for each triangle that goes into a Boolean, its own arrays and those of the result included; measured."""

OVERLAP = 1e-9
"""Volume that shells of the domain share, as a fraction of all, above which they are united; less is rounding."""


@dataclass(frozen=True, kw_only=True)
class BooleanFill(Stage):
    """Extract the microstructure's surface and intersect it with the mesh of the part, by manifold3d.

    The result is a mesh in which the part's own surface is kept exactly, sharp edges included. It costs memory and time
    for every triangle; `fill.implicit` needs neither and is the way to layers. The skin is what a Boolean with a second
    mesh, offset inwards, would leave: the offset is a level set of the distance from the part's surface, exact to
    within a fraction of a voxel. Shells of the part that overlap are united first.
    """

    name: ClassVar[str] = "fill.boolean"
    libraries: ClassVar[tuple[str, ...]] = ("manifold3d",)
    advice: ClassVar[str] = "lower `resolution`, or use `fill.implicit`, which needs no mesh"
    version: ClassVar[int] = 3

    resolution: int | None = options.resolution(
        None, note="32 if `voxel` is not given either", minimum=MIN_VOXELS, maximum=MAX_VOXELS
    )
    voxel: Length | None = options.voxel(
        None, note="at most this long, instead of `resolution`; the cell is cut into equal parts", formerly="spacing"
    )
    skin: Length | None = options.skin(None, above=0, maximum=1e6)
    islands: str = options.islands("auto", note="in the finished part")
    time_limit: float = options.time_limit(600.0, note="there is one for the Boolean")

    def check_options(self) -> None:
        if self.resolution is not None and self.voxel is not None:
            raise ConfigError("`resolution` and `voxel` exclude each other")

    def estimate(self, palette: Palette, field: Size, domain: Size) -> Size:
        body, n = field.body, expected_voxels(field.body.edge_mm, self.resolution, self.voxel)
        part = domain.body.in_unit(body.scale)
        made = replace(part, porosity=body.porosity, surface=body.surface, kernels=body.kernels)
        # a skin ends twice more, outward and inward
        ends = 2 * part.envelope * n**2 if self.skin else 0.0
        return replace(field, geometry=made).grid(n, triangles=made.triangles(n) + ends + domain.triangles)

    def run(self, context: Context, field: ScalarField, domain: SurfaceMesh) -> SurfaceMesh:
        """Extract, predict the memory, intersect, check."""
        from sppm_pipeline.features.surface.numerics.meshcheck.bodies import find_shells, largest_body
        from sppm_pipeline.method.connectivity.removal import report_removal
        from sppm_pipeline.services.mesh.measures import volume

        edge = field.physical_edge()
        check_solid(domain.vertices, domain.faces, domain.name)
        domain = _without_overlaps(domain, ManifoldLimits(self.time_limit, child_memory(context.memory_limit)))
        n = voxels_along_edge(field, self.resolution, self.voxel)
        if (coarse := field.coarseness(1 / n)) is not None:
            context.warn(coarse)
        part = Part(field, domain, self.skin.mm() if self.skin else 0.0, "keep")
        surface = FieldSurface(part, node_grid(part, n), "keep", caps=False, cut=False)
        expected = surface.expected_triangles(context.threads) + len(domain.faces)
        needed = expected * BOOLEAN_BYTES
        context.report(resolution=n, expected_triangles=expected, expected_gigabytes=needed / 1e9)
        require_memory(
            needed,
            f"a Boolean of about {expected / 1e6:.3g} million triangles",
            f"lower `resolution` (now {n}; half of it needs a quarter of the memory), or use `fill.implicit`, which "
            "needs no mesh",
            limit=context.memory_limit,
        )
        vertices, faces, _ = surface.mesh(context.threads, lambda done, of: context.progress(done, of, "planes"))
        if not len(faces):
            raise DesignError("there is no solid in the part", hint="lower the porosity or the level, or add a skin")
        vertices *= edge
        vertices += np.array(field.origin_mm)
        made = manifold_combine(
            (vertices, faces),
            (domain.vertices, domain.faces),
            "intersection",
            ("the microstructure", domain.name),
            ManifoldLimits(self.time_limit, child_memory(context.memory_limit)),
        ).mesh
        context.report(microstructure_triangles=len(faces), domain_volume_mm3=volume(domain.vertices, domain.faces))
        del vertices, faces
        shells = find_shells(*made)
        whole = float(shells.volumes.sum())
        context.report(bodies=shells.bodies, cavities=shells.cavities)
        if self.islands != "keep":
            made = largest_body(*made, shells)
            report_removal(context, 1 - volume(*made) / whole, self.islands)
        return SurfaceMesh(*made, name=domain.name)


def _without_overlaps(domain: SurfaceMesh, limits: ManifoldLimits) -> SurfaceMesh:
    """The domain with its shells united where they overlap, which manifold3d would count twice.

    InputError if one shell runs through itself, or a hollow of one lies in the solid of another.
    """
    from sppm_pipeline.services.mesh.measures import volume
    from sppm_pipeline.services.mesh.orientation import shells

    outer, summed = domain.outer_surface, volume(domain.vertices, domain.faces)
    if outer is None or abs(summed - outer.volume) <= OVERLAP * summed:
        return domain
    found = shells(domain.vertices, domain.faces)
    united: tuple[F64, I32] | None = None
    # a hollow is smaller than the shell that it is in, and larger than a body within it
    for number in np.argsort(-np.abs(found.volumes), kind="stable"):
        faces = domain.faces[found.labels == number]
        hollow = found.volumes[number] < 0
        shell = domain.vertices, np.ascontiguousarray(faces[:, ::-1] if hollow else faces)
        names = domain.name, f"shell {number} of {domain.name}"
        united = (
            manifold_combine(united, shell, "difference" if hollow else "union", names, limits).mesh
            if united is not None
            else shell
        )
    if united is None or abs(volume(*united) - outer.volume) > 1e3 * OVERLAP * outer.volume:
        raise InputError(
            f"{domain.name} overlaps itself in a way that manifold3d cannot unite",
            hint="use `fill.implicit`, which unites any overlaps, or repair the mesh with `mesh.repair`",
        )
    return SurfaceMesh(*united, domain.name)
