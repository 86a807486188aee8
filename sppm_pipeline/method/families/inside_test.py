"""The inside test of a mesh, for stages that fill or slice one: choose a method, report how sure it is, or refuse."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

from sppm_pipeline.errors import InputError
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.stage import Context

if TYPE_CHECKING:
    from sppm_pipeline.method.part.inside import Method

MAX_UNDECIDED = 0.25
"""Undecided voxels over those inside; above, the inside is guesswork."""

_WORDS = {"scanline": "rays along x", "winding": "its winding number", "vote": "a vote of rays along x, y and z"}


def outward_mesh(context: Context, mesh: SurfaceMesh, inside: str) -> tuple[SurfaceMesh, Method]:
    """Wind a mesh outwards and choose its inside test (a method, or "auto"); the run record says how sure that is.

    Raises InputError if too much of the inside is undecided.
    """
    from sppm_pipeline.method.part.inside import inside_test

    if not len(mesh.faces):
        raise InputError(f"{mesh.name} has no triangles, so it has no inside")
    found = inside_test(mesh.vertices, mesh.faces, None if inside == "auto" else cast("Method", inside))
    context.report(inside=found.method, closed=found.closed, turned_triangles=found.turned)
    if found.turned:
        mesh = SurfaceMesh(mesh.vertices, found.faces, mesh.name, mesh.groups)
        context.warn(f"{found.turned} of {len(found.faces)} triangles of {mesh.name} were turned to face outwards")
    # only an open surface leaves doubts
    if found.closed:
        return mesh, found.method
    context.report(undecided_share=found.undecided_share, disagreement=found.disagreement)
    what = (
        f"{mesh.name} is not closed; its inside is decided by {_WORDS[found.method]}, "
        f"and {found.undecided_share:.1%} of it is doubtful"
    )
    if found.undecided_share > MAX_UNDECIDED:
        raise InputError(
            f"{what}: more than the {MAX_UNDECIDED:.0%} that are accepted, so there is no telling inside from outside",
            hint="let `check.mesh` say what is wrong, then close the holes in a modeler or with a repair plugin",
        )
    context.warn(f"{what}; winding number and rays differ on {found.disagreement:.1%}: look at the layers")
    return mesh, found.method
