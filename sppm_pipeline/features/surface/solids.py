"""Booleans of solids and extraction of surfaces by manifold3d in a child process, with the bytes of a direct call.

manifold3d is careful code, but degenerate meshes have crashed it and kept it busy for hours. The child calls the
functions of `numerics`, their checks included, so that messages are the same as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.engine.process.exchange import ArraySpec, notify
from sppm_pipeline.engine.process.native import NativeResult, run_native

COMBINE, EXTRACT = (
    "sppm_pipeline.features.surface.solids:combine_in_child",
    "sppm_pipeline.features.surface.solids:extract_in_child",
)

_MESH = {"vertices": ArraySpec("float64", (None, 3)), "faces": ArraySpec("int32", (None, 3))}
_HINT = "look at the meshes with `check.mesh`, take fewer triangles, or give a larger `time_limit`"

Mesh = tuple[NDArray[np.float64], NDArray[np.int32]]
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
    places: Sequence[NDArray[np.float64]] = (),
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
    from sppm_pipeline.features.surface.numerics.booleans import boolean
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
    samples: NDArray[np.float32],
    origin: tuple[float, float, float],
    spacing: float,
    tolerance: float | None,
    limits: ManifoldLimits,
) -> tuple[Mesh, str]:
    """The surface of a sampled solid, by `level_set.run_level_set` in a child process; errors as of `run_native`."""
    options = {"origin": [float(v) for v in origin], "spacing": float(spacing), "tolerance": tolerance}
    found = _run(EXTRACT, {"samples": samples}, options, limits)
    return (found.arrays["vertices"], found.arrays["faces"]), str(found.values["status"])


def extract_in_child(arrays: Arrays, options: Mapping[str, Any]) -> tuple[Values, Values]:
    """Extract the surface."""
    from sppm_pipeline.features.surface.numerics.level_set import run_level_set

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
