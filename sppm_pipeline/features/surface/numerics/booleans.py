"""Solids as meshes and their Booleans, by manifold3d (Apache-2.0), whose failures are silent and therefore looked for.

manifold3d never raises: a mesh that is no oriented manifold becomes an empty solid with a status, and every result that
it takes part in is empty; an inside-out mesh and a double sheet give garbage, or nothing, with the status "NoError". So
every mesh is checked before, and the volume of every result is compared with what set theory allows.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.services.mesh.marching_cubes import Mesh
from sppm_pipeline.services.mesh.measures import balanced_edges, edge_counts, volume

OPERATIONS = {"union": "Add", "difference": "Subtract", "intersection": "Intersect"}
"""Name of each operation here and in manifold3d."""

TOLERANCE = 1e-6
"""By how much, as a fraction of the larger volume, a result may leave its bounds; rounding is far below."""


class BooleanOutcome(NamedTuple):
    """The result of a Boolean by manifold3d."""

    vertices: NDArray[np.float64]  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    statuses: tuple[str, str, str]  # of both operands and of the result; "NoError" if all is well
    volumes: tuple[float, float, float]  # of both operands and of the result


def run_boolean(
    first_vertices: NDArray[np.float64],
    first_faces: NDArray[np.int32],
    second_vertices: NDArray[np.float64],
    second_faces: NDArray[np.int32],
    operation: str,
) -> BooleanOutcome:
    """The call into the native library and nothing else: arrays in, arrays out, no checks."""
    import manifold3d

    def solid(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> manifold3d.Manifold:
        # the binding takes no read-only arrays, though it only reads them
        return manifold3d.Manifold(
            manifold3d.Mesh64(np.require(vertices, np.float64, ("C", "W")), faces.astype(np.uint64, order="C"))
        )

    operands = [solid(first_vertices, first_faces), solid(second_vertices, second_faces)]
    result = manifold3d.Manifold.batch_boolean(operands, getattr(manifold3d.OpType, OPERATIONS[operation]))
    first, second, third = (part.status().name for part in (*operands, result))
    a, b, c = (float(part.volume()) for part in (*operands, result))
    del operands
    made = result.to_mesh64()
    vertices = np.array(made.vert_properties[:, :3], np.float64)
    return BooleanOutcome(vertices, np.array(made.tri_verts, np.int32), (first, second, third), (a, b, c))


def check_solid(vertices: NDArray[np.float64], faces: NDArray[np.int32], name: str) -> float:
    """Volume of a mesh, (n, 3) and (m, 3), that messages call `name`.

    InputError if it has no triangle, is not closed, is wound inconsistently, or has no positive volume.
    """
    if not len(faces):
        raise InputError(f"{name} has no triangle", hint="look at the stage that made it")
    if not balanced_edges(faces):
        counts = edge_counts(faces)
        raise InputError(
            f"{name} does not bound a solid: {counts.boundary} open edges, {counts.non_manifold} edges of three or "
            f"more triangles, {counts.unbalanced} edges where the winding does not match",
            hint="look at it with `check.mesh` and repair it (`sppm stages` lists stages for that); "
            "`fill.implicit` also takes meshes that do not close",
        )
    enclosed = volume(vertices, faces)
    if not enclosed > 0:
        raise InputError(
            f"{name} encloses a volume of {enclosed:.6g}: it is wound inside out, or a double sheet",
            hint="turn the winding of its faces; a sheet without thickness can't be filled",
        )
    return enclosed


def boolean(first: Mesh, second: Mesh, operation: str, names: tuple[str, str] = ("the first", "the second")) -> Mesh:
    """Union, difference (the first without the second) or intersection of two solids that messages call `names`.

    Meshes, ((n, 3), (m, 3)), are closed and wound outwards, the result too; the same bytes for the same input.
    InputError if one does not bound a solid, DesignError if nothing is left, or the result can't be right.
    """
    volumes = [check_solid(*mesh, name) for mesh, name in zip((first, second), names, strict=True)]
    outcome = run_boolean(*first, *second, operation)
    for name, status, own, theirs in zip(names, outcome.statuses, volumes, outcome.volumes, strict=False):
        if status != "NoError":
            raise InputError(
                f"{name} is no oriented manifold (manifold3d says {status})",
                hint="look at it with `check.mesh` and repair it; `fill.implicit` is less particular",
            )
        if abs(own - theirs) > max(1e-3 * own, TOLERANCE * max(volumes)):
            raise InputError(
                f"{name} encloses {own:.6g}, but only {theirs:.6g} of it are left when sheets without thickness "
                "and triangles without area are taken out",
                hint="repair it: remove doubled faces and faces that touch back to back",
            )
    if outcome.statuses[2] != "NoError":
        raise DesignError(f"manifold3d could not compute the {operation}: {outcome.statuses[2]}")
    vertices, faces = outcome.vertices, outcome.faces
    if not len(faces):
        raise DesignError(
            f"nothing is left of the {operation} of {names[0]} and {names[1]}",
            hint="see whether the two overlap: compare their places and sizes",
        )
    a, b = volumes
    low, high = {"union": (max(a, b), a + b), "difference": (a - b, a), "intersection": (0.0, min(a, b))}[operation]
    slack, found = TOLERANCE * max(a, b), volume(vertices, faces)
    if not balanced_edges(faces) or not max(low, 0.0) - slack <= found <= high + slack:
        raise DesignError(
            f"the {operation} of {names[0]} ({a:.6g}) and {names[1]} ({b:.6g}) came out with a volume of {found:.6g}; "
            f"between {max(low, 0.0):.6g} and {high:.6g} is possible",
            hint="one of the meshes may run through itself: look at both with `check.mesh`",
        )
    return vertices, faces
