"""manifold3d's own extractor: marching tetrahedra on a body-centered cubic lattice, fed from samples of the field.

manifold3d asks for values one by one through Python, and that is what it costs: 0.2 microseconds a value for the call
itself. So the field is sampled beforehand, by the kernels that do that a hundred times faster, on the cubic grid of
half the spacing, of which the body-centered lattice is a part. What is called is one compiled function with the samples
bound to it: it finds the value at a lattice point exactly, and between samples by trilinear interpolation. (Timed per
value, the calls of the extractor included: a look-up written in Python 0.8 microseconds, a C function pointer
through ctypes 0.6, this function 0.5.)
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.marching_cubes import Mesh

STEP = 2.0**-8
"""Fraction of the way to the middle of its neighbors by which a vertex is moved."""


def run_level_set(
    samples: NDArray[np.float32], origin: tuple[float, float, float], spacing: float, tolerance: float | None = None
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
    if any(n != 2 * c + 1 or c < 1 for n, c in zip(reversed(samples.shape), cubes, strict=True)):
        raise ValueError(f"samples on half the spacing are odd in number along each axis, not {samples.shape}")
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


def coincident_vertices(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """Indices of the vertices (n, 3) whose coordinates, in single precision, are those of another one."""
    _, place, count = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True, return_counts=True)
    return np.flatnonzero(count[place.reshape(-1)] > 1)


def separate_coincident_vertices(
    vertices: NDArray[np.float64], faces: NDArray[np.int32], low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.float64]:
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
def _minus_value_at(
    values: NDArray[np.float32], x0: float, y0: float, z0: float, scale: float, x: float, y: float, z: float
) -> float:
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
