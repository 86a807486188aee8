"""Meshes placed several times by transformations, as GLB and 3MF files do it, made into one mesh."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.mesh_arrays import DecodedMesh

Matrix = NDArray[np.float64]
"""(3, 4): turn, scale or shear in the first three columns, the shift in the last one."""

IDENTITY: Matrix = np.eye(3, 4)
IDENTITY.flags.writeable = False

MOST_TRIANGLES = 2**25
"""A few kilobytes can ask for any number of copies; more triangles than this are not made of them."""

MOST_PLACED = 2**17
"""Objects and copies of objects in one file, empty ones included."""

_AT_ONCE = 2**20  # vertices


def after(outer: Matrix, inner: Matrix) -> Matrix:
    """The transformation that does `inner` first."""
    if outer is IDENTITY:
        return inner
    with np.errstate(over="ignore", invalid="ignore"):
        turned: Matrix = (outer[:, :3, None] * inner[None]).sum(axis=1)
        turned[:, 3] += outer[:, 3]
    return turned


def require_few(name: str, placed: int, vertices: int, triangles: int) -> None:
    """Raise InputError, before anything is allocated, if the copies of a file add up to too much."""
    for count, limit, what in (
        (placed, MOST_PLACED, "copies of objects"),
        (triangles, MOST_TRIANGLES, "triangles"),
        (vertices, MOST_TRIANGLES, "vertices"),
    ):
        if count > limit:
            many = str(count) if count < 10**18 else "more than 10^18"
            raise InputError(
                f"{name}: its objects, placed again and again, add up to {many} {what}; at most {limit} are read",
                hint="place fewer copies, or read one cell and let a `tile` stage repeat it",
            )


def place(name: str, meshes: Sequence[DecodedMesh], placed: Sequence[tuple[int, Matrix]]) -> DecodedMesh:
    """One mesh of all copies, in their order; a copy that is mirrored keeps its outside.

    Parameters
    ----------
    name : str
        How to call the file in messages.
    meshes : sequence of ((n, 3) float64, (m, 3) int64)
    placed : sequence of (index of a mesh, transformation)

    Raises
    ------
    InputError
        If the copies are too many, or one is moved beyond all numbers.
    """
    vertices = sum(len(meshes[which][0]) for which, _ in placed)
    triangles = sum(len(meshes[which][1]) for which, _ in placed)
    require_few(name, len(placed), vertices, triangles)
    points, faces = np.empty((vertices, 3)), np.empty((triangles, 3), np.int64)
    n = m = 0
    for which, group in groupby(placed, key=lambda copy: copy[0]):
        corners, triangle = meshes[which]
        matrices = np.array([matrix for _, matrix in group])
        step = max(1, _AT_ONCE // max(1, len(corners)))
        for some in (matrices[k : k + step] for k in range(0, len(matrices), step)):
            copies, (v, f) = len(some), (len(corners), len(triangle))
            _move(some, corners, points[n : n + copies * v].reshape(copies, v, 3))
            numbers = faces[m : m + copies * f].reshape(copies, f, 3)
            np.add(triangle, n + v * np.arange(copies)[:, None, None], out=numbers)
            mirrored = _determinants(some) < 0
            numbers[mirrored] = numbers[mirrored][:, :, ::-1]
            n, m = n + copies * v, m + copies * f
    if not np.isfinite(points).all():
        raise InputError(f"{name}: a transformation moves vertices beyond all numbers")
    return points, faces


def _move(matrices: NDArray[np.float64], corners: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    x, y, z = corners.T
    with np.errstate(over="ignore", invalid="ignore"):
        for axis in range(3):
            a, b, c, shift = (matrices[:, axis, k, None] for k in range(4))
            out[:, :, axis] = a * x + b * y + c * z + shift


def _determinants(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c = (matrices[:, axis, :3] for axis in range(3))
    with np.errstate(over="ignore", invalid="ignore"):
        found: NDArray[np.float64] = (a * np.cross(b, c)).sum(axis=1)
    return found
