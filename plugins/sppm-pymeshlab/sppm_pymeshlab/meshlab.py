"""Our side of a filter: the child is called, and what it returns is a mesh or an error."""

from __future__ import annotations

from typing import Any

import numpy as np

from sppm_pipeline import Context, DesignError, InputError, SurfaceMesh, run_native
from sppm_pipeline.nouns import ArraySpec

LARGEST = 20_000_000
"""Triangles; MeshLab needs about 1 kB for each."""

_MESH = {"vertices": ArraySpec("float64", (None, 3)), "faces": ArraySpec("int32", (None, 3))}
_HINT = "run mesh.repair first if the mesh has defects, or decimate it; `time_limit` gives more time"


class Refused(DesignError):
    """MeshLab would not do what was asked; the mesh is as before."""


def filtered(mesh: SurfaceMesh, name: str, seconds: float, **options: Any) -> SurfaceMesh:
    """Apply one filter of `filters` in a child process; errors as of `run_native`.

    `Refused` if MeshLab refuses, or leaves nothing; `InputError` if the mesh is empty or too large.
    """
    if not len(mesh.faces):
        raise InputError(f"{mesh.name} has no triangles")
    if len(mesh.faces) > LARGEST:
        raise InputError(f"{mesh.name} has {len(mesh.faces)} triangles; at most {LARGEST} are taken")
    result = run_native(
        "sppm_pymeshlab.filters:apply",
        {"vertices": mesh.vertices, "faces": mesh.faces},
        {"filter": name, **options},
        returns=_MESH,
        distribution="pymeshlab",
        seconds=seconds,
        hint=_HINT,
    )
    if "refused" in result.values:
        raise Refused(f"{name}: {result.values['refused']}")
    faces = result.arrays["faces"]
    if faces.min() < 0 or faces.max() >= len(result.arrays["vertices"]):
        raise Refused(f"{name}: the result names vertices that do not exist")
    return SurfaceMesh(result.arrays["vertices"], faces, mesh.name)


def self_intersections(mesh: SurfaceMesh, seconds: float) -> int:
    """Number of triangles that pass through another one."""
    result = run_native(
        "sppm_pymeshlab.filters:count_self_intersections",
        {"vertices": mesh.vertices, "faces": mesh.faces},
        returns={},
        distribution="pymeshlab",
        seconds=seconds,
        hint=_HINT,
    )
    return int(result.values["triangles"])


def worked(context: Context, mesh: SurfaceMesh, name: str, seconds: float, **options: Any) -> SurfaceMesh:
    """Apply one filter to a mesh that must not get worse by it, and report volumes and triangles.

    `DesignError` if a closed mesh comes back open, or its volume is gone.
    """
    from sppm_pipeline.numerics import mesh_edges as edge_counts
    from sppm_pipeline.numerics import mesh_volume as volume

    made = filtered(mesh, name, seconds, **options)
    before, after = edge_counts(mesh.faces), edge_counts(made.faces)
    if (before.closed and not after.closed) or (before.bounds_solid and not after.bounds_solid):
        raise DesignError(
            f"{name} has opened {mesh.name}: {after.boundary} open edges, {after.non_manifold} edges of three or more "
            f"triangles; it was {'closed' if before.closed else 'a solid'} before",
            hint="ask for less at a time (a finer edge, more triangles), or run mesh.repair afterwards",
        )
    compared(context, mesh, made)
    if before.bounds_solid and volume(made.vertices, made.faces) * volume(mesh.vertices, mesh.faces) <= 0:
        raise DesignError(
            f"{name} has destroyed the volume of {mesh.name}", hint="ask for less (a finer edge, more triangles)"
        )
    return made


def compared(context: Context, before: SurfaceMesh, after: SurfaceMesh) -> None:
    """Report what has changed: triangles, edge lengths, and the volume if there is one."""
    from sppm_pipeline.numerics import mesh_volume as volume

    was, now = (volume(mesh.vertices, mesh.faces) for mesh in (before, after))
    context.report(triangles_before=len(before.faces), volume_before_mm3=was, volume_after_mm3=now)
    if before.bounds_solid and was:
        context.report(volume_change=now / was - 1)
    corners = after.vertices[after.faces]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    context.report(mean_edge_mm=float(edges.mean()), shortest_edge_mm=float(edges.min()))
