"""Booleans of solids and extraction of surfaces by manifold3d in a child process, with the bytes of a direct call.

manifold3d is careful code, but degenerate meshes have crashed it and kept it busy for hours. The child calls the
functions of `numerics`, their checks included, so that messages are the same as well.

Solids as meshes and their Booleans, by manifold3d (Apache-2.0), whose failures are silent and therefore looked for.

manifold3d never raises: a mesh that is no oriented manifold becomes an empty solid with a status, and every result that
it takes part in is empty; an inside-out mesh and a double sheet give garbage, or nothing, with the status "NoError". So
every mesh is checked before, and the volume of every result is compared with what set theory allows.

manifold3d's own extractor: marching tetrahedra on a body-centered cubic lattice, fed from samples of the field.

manifold3d asks for values one by one through Python, and that is what it costs: 0.2 microseconds a value for the call
itself. So the field is sampled beforehand, by the kernels that do that a hundred times faster, on the cubic grid of
half the spacing, of which the body-centered lattice is a part. What is called is one compiled function with the samples
bound to it: it finds the value at a lattice point exactly, and between samples by trilinear interpolation. (Timed per
value, the calls of the extractor included: a look-up written in Python 0.8 microseconds, a C function pointer
through ctypes 0.6, this function 0.5.)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.engine.process.exchange import ArraySpec, notify
from sppm_pipeline.engine.process.native import NativeResult, run_native
from sppm_pipeline.errors import DesignError, InputError
from sppm_pipeline.services.arrays import F32, F64, I32, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import Mesh
from sppm_pipeline.services.mesh.measures import balanced_edges, edge_counts, volume

STEP = 2.0**-8
"""Fraction of the way to the middle of its neighbors by which a vertex is moved."""


def run_level_set(
    samples: F32, origin: tuple[float, float, float], spacing: float, tolerance: float | None = None
) -> tuple[Mesh, str]:
    """Surface of the solid in a box, by the native library, without checks; and its status, "NoError" if all is well.

    `samples`, (2 nz + 1, 2 ny + 1, 2 nx + 1), are a field, negative in the solid, on the grid of half the `spacing` of
    the lattice's cubes; the first and last ones lie on the box with its low corner at `origin`. `tolerance` is how near
    to the zero of the interpolated field every vertex is brought; without it, it is put where linear interpolation
    between two lattice points has the zero. The mesh, (n, 3) and (m, 3), is closed by the box and wound outwards, with
    no two vertices at one place.
    """
    import manifold3d

    cubes = [(n - 1) // 2 for n in reversed(samples.shape)]
    values = np.ascontiguousarray(samples, np.float32)
    x, y, z = (float(v) for v in origin)
    box = [x, y, z, *(o + c * spacing for o, c in zip((x, y, z), cubes, strict=True))]
    inside = partial(_minus_value_at, values, x, y, z, 2.0 / spacing)
    inside(x, y, z)  # compiled here, where a failure can be caught
    # The lattice has as many cubes along each axis as edges fit in; a little less than the spacing makes it the grid's.
    made = manifold3d.Manifold.level_set(
        inside, box, spacing * (1 - 1e-9), 0.0, -1.0 if tolerance is None else tolerance
    )
    if made.num_tri():
        # read again, it loses the triangles without area that the extractor leaves
        arrays = made.to_mesh64()
        made = manifold3d.Manifold(manifold3d.Mesh64(np.array(arrays.vert_properties), np.array(arrays.tri_verts)))
    arrays = made.to_mesh64()
    vertices = np.array(arrays.vert_properties[:, :3], np.float64)
    faces = np.array(arrays.tri_verts, np.int32).reshape(-1, 3)
    vertices = separate_coincident_vertices(vertices, faces, np.array(box[:3]), np.array(box[3:]))
    return (vertices, faces), str(made.status().name)


def lattice_samples(grid: Grid) -> int:
    """Number of values that the extractor requests on a lattice of cubes with corners at the nodes of `grid`."""
    nx, ny, nz = grid.shape
    return nx * ny * nz + (nx + 1) * (ny + 1) * (nz + 1)


def lattice_bytes(grid: Grid) -> int:
    """Memory for the extractor's values, which it keeps in a table with powers of two along y and z."""
    nx, ny, nz = grid.shape
    padded: int = 1 << (1 + (ny + 2).bit_length() + (nz + 2).bit_length())
    return 8 * (nx + 3) * padded


def coincident_vertices(vertices: F64) -> I64:
    """Indices of the vertices (n, 3) whose coordinates, in single precision, are those of another one."""
    _, place, count = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True, return_counts=True)
    return np.flatnonzero(count[place.reshape(-1)] > 1)


def separate_coincident_vertices(vertices: F64, faces: I32, low: F64, high: F64) -> F64:
    """The vertices (n, 3) of a closed manifold, coincident ones moved apart, each a little towards its own neighbors.

    Where two tips touch, a mesh that is manifold by its indices has two vertices at one place. A file that keeps no
    indices (STL), or a reader that merges coincident vertices, makes one non-manifold vertex of them, or of two edges a
    non-manifold edge. A tip of solid is drawn back into the solid and a tip of void into the void, so that nothing
    overlaps. Coordinates on the faces of the box (`low`, `high`) stay where triangles lie in them; a tip that only
    touches a face is drawn back from it.
    """
    moved = vertices.copy()
    # until nothing coincides; bounded, as a vertex that is moved may land on another one
    for _ in range(8):
        coincident = coincident_vertices(moved)
        if not len(coincident):
            break
        concerned = np.zeros(len(vertices), np.bool_)
        concerned[coincident] = True
        near = faces[concerned[faces].any(axis=1)]
        total, count = np.zeros_like(vertices), np.zeros(len(vertices))
        for corner in range(3):
            for other in (1, 2):
                np.add.at(total, near[:, corner], moved[near[:, (corner + other) % 3]])
                np.add.at(count, near[:, corner], 1)
        step = STEP * (total[coincident] / count[coincident, None] - moved[coincident])
        capped = np.zeros(vertices.shape, np.bool_)
        for side in (low, high):
            flat = (moved[near] == side).all(axis=1)
            for corner in range(3):
                np.logical_or.at(capped, near[:, corner], flat)
        step[capped[coincident]] = 0.0
        moved[coincident] += step
    return moved


@jit
def _minus_value_at(values: F32, x0: float, y0: float, z0: float, scale: float, x: float, y: float, z: float) -> float:
    """The trilinear interpolant with its sign turned, as manifold3d has its solid where values are positive."""
    nz, ny, nx = values.shape
    # a fraction of a millionth is rounding: lattice points are to have the value of their sample
    u = min(max((x - x0) * scale, 0.0), nx - 1.0)
    v = min(max((y - y0) * scale, 0.0), ny - 1.0)
    w = min(max((z - z0) * scale, 0.0), nz - 1.0)
    i, j, k = min(int(u + 1e-6), nx - 2), min(int(v + 1e-6), ny - 2), min(int(w + 1e-6), nz - 2)
    u, v, w = u - i, v - j, w - k
    u = 0.0 if u < 1e-6 else u
    v = 0.0 if v < 1e-6 else v
    w = 0.0 if w < 1e-6 else w
    total = 0.0
    for dk in range(2):
        for dj in range(2):
            share = (w if dk else 1.0 - w) * (v if dj else 1.0 - v)
            if share > 0.0:
                row = values[k + dk, j + dj, i] * (1.0 - u)
                if u > 0.0:
                    row += values[k + dk, j + dj, i + 1] * u
                total += share * row
    return -total


OPERATIONS = {"union": "Add", "difference": "Subtract", "intersection": "Intersect"}
"""Name of each operation here and in manifold3d."""

TOLERANCE = 1e-6
"""By how much, as a fraction of the larger volume, a result may leave its bounds; rounding is far below."""


class BooleanOutcome(NamedTuple):
    """The result of a Boolean by manifold3d."""

    vertices: F64  # (n, 3)
    faces: I32  # (m, 3)
    statuses: tuple[str, str, str]  # of both operands and of the result; "NoError" if all is well
    volumes: tuple[float, float, float]  # of both operands and of the result


def run_boolean(
    first_vertices: F64, first_faces: I32, second_vertices: F64, second_faces: I32, operation: str
) -> BooleanOutcome:
    """The call into the native library and nothing else: arrays in, arrays out, no checks."""
    import manifold3d

    def solid(vertices: F64, faces: I32) -> manifold3d.Manifold:
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


def check_solid(vertices: F64, faces: I32, name: str) -> float:
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


COMBINE, EXTRACT = (
    "sppm_pipeline.features.surface.solids:combine_in_child",
    "sppm_pipeline.features.surface.solids:extract_in_child",
)

_MESH = {"vertices": ArraySpec("float64", (None, 3)), "faces": ArraySpec("int32", (None, 3))}
_HINT = "look at the meshes with `check.mesh`, take fewer triangles, or give a larger `time_limit`"

Values = dict[str, Any]
Arrays = Mapping[str, NDArray[Any]]


class ManifoldLimits(NamedTuple):
    """Limits of one child."""

    seconds: float
    memory: int | None = None  # bytes; None for what is available
    progress: Callable[[float, float, str], object] | None = None  # called with done, total, step


class Combined(NamedTuple):
    """The result of a Boolean."""

    mesh: Mesh
    tool_volume: float  # of the second operand, its copies united


def manifold_combine(
    first: Mesh,
    second: Mesh,
    operation: str,
    names: tuple[str, str],
    limits: ManifoldLimits,
    *,
    places: Sequence[F64] = (),
) -> Combined:
    """Union, difference or intersection of two closed solids, wound outwards, by `booleans.boolean` in a child process.

    `names` are those of the solids in messages. Copies of the second one are put at `places`, (3,) each, and united
    beforehand; without places it stays where it is. Errors are those of `boolean` and of `run_native`.
    """
    (first_vertices, first_faces), (vertices, faces) = first, second
    arrays: dict[str, NDArray[Any]] = {
        "first_vertices": first_vertices,
        "first_faces": first_faces,
        "vertices": vertices,
        "faces": faces,
    }
    if len(places):
        arrays["places"] = np.array(places, np.float64)
    found = _run(COMBINE, arrays, {"operation": operation, "names": list(names)}, limits)
    return Combined((found.arrays["vertices"], found.arrays["faces"]), float(found.values["tool_volume"]))


def combine_in_child(arrays: Arrays, options: Mapping[str, Any]) -> tuple[Values, Values]:
    """Unite the copies of the second solid, then combine both."""
    from sppm_pipeline.services.mesh.measures import volume

    first, second = (arrays["first_vertices"], arrays["first_faces"]), (arrays["vertices"], arrays["faces"])
    operation, (name, tool) = options["operation"], options["names"]
    if "places" in arrays:
        vertices, faces = second
        places = arrays["places"]
        second = (vertices + places[0], faces)
        for number, place in enumerate(places[1:], 1):
            notify("union of copies", number, len(places))
            second = boolean(second, (vertices + place, faces), "union", (tool, tool))
    notify(operation)
    vertices, faces = boolean(first, second, operation, (name, tool))
    return {"vertices": vertices, "faces": faces}, {"tool_volume": float(volume(*second))}


def manifold_extract(
    samples: F32, origin: tuple[float, float, float], spacing: float, tolerance: float | None, limits: ManifoldLimits
) -> tuple[Mesh, str]:
    """The surface of a sampled solid, by `level_set.run_level_set` in a child process; errors as of `run_native`."""
    options = {"origin": [float(v) for v in origin], "spacing": float(spacing), "tolerance": tolerance}
    found = _run(EXTRACT, {"samples": samples}, options, limits)
    return (found.arrays["vertices"], found.arrays["faces"]), str(found.values["status"])


def extract_in_child(arrays: Arrays, options: Mapping[str, Any]) -> tuple[Values, Values]:
    """Extract the surface."""
    notify("level set")
    (vertices, faces), status = run_level_set(
        arrays["samples"], options["origin"], options["spacing"], options["tolerance"]
    )
    return {"vertices": vertices, "faces": faces}, {"status": status}


def _run(function: str, arrays: Arrays, options: Values, limits: ManifoldLimits) -> NativeResult:
    return run_native(
        function, arrays, options, returns=_MESH, distribution="manifold3d", seconds=limits.seconds,
        memory=limits.memory, hint=_HINT, progress=limits.progress,
    )  # fmt: skip
