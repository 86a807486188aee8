"""Crossings of rays along the rows of a grid with the triangles of a mesh.

Rays through edges and vertices need no special cases. A layer z = z_k cuts an edge if exactly one of its ends has
z <= z_k; so a triangle is cut in no edge or in two, one going up and one going down. The triangle counts on the rows
from one cut to the other, the first included and the last not. Both triangles at an edge compute its cut with the same
operations on the same numbers (from the lower end to the upper), hence agree to the last bit. So the signs along a ray
add up to exactly 0 over a closed mesh, however degenerate; a sum that is not 0 proves a hole or a flipped triangle.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.arrays import F64, I32, I64
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit

_CHUNK = 16  # layers that share one list of triangles


def as_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[F64, I32]:
    """A mesh (n, 3), (m, 3) in the types that the kernels are compiled for, C-contiguous float64 and int32.

    An InputError names a coordinate that is not finite or an index that names no vertex.
    """
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    raw = np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or raw.ndim != 2 or raw.shape[1] != 3 or raw.dtype.kind not in "iu":
        raise ValueError(f"a mesh is (n, 3) floats and (m, 3) integers, not {points.shape} and {raw.shape} {raw.dtype}")
    if not np.isfinite(points).all():
        bad = int(np.count_nonzero(~np.isfinite(points).all(axis=1)))
        raise InputError(f"{bad} of {len(points)} vertices have a coordinate that is not finite")
    if raw.size and (int(raw.min()) < 0 or int(raw.max()) >= len(points)):
        raise InputError(f"faces name vertices {raw.min()} to {raw.max()}, the mesh has {len(points)}")
    return points, np.ascontiguousarray(raw, dtype=np.int32)


class Scan(NamedTuple):
    """A mesh made ready for scanning; coordinates are in the order ray, row, layer."""

    vertices: F64
    faces: I32
    # (chunks + 1,); the triangles that may cut the layers of chunk c are listed[starts[c] : starts[c + 1]]
    starts: I64
    listed: I32
    origin: F64  # of the samples, as the spacing
    spacing: F64
    shape: tuple[int, int, int]  # samples along ray, row, layer


def prepare_scan(vertices: ArrayLike, faces: ArrayLike, grid: Grid, axis: int = 0) -> Scan:
    """Sort the triangles of a mesh, wound outwards, by layers of a grid of samples (voxel centers) of the whole part.

    Vertices need not be merged. Rays along x (axis 0) make whole layers from contiguous rows.
    """
    points, triangles = as_mesh(vertices, faces)
    # x: (x, y, z); y: (y, x, z), which mirrors, so that the winding is turned round; z: (z, x, y)
    order = ((0, 1, 2), (1, 0, 2), (2, 0, 1))[axis]
    if axis == 1:
        triangles = np.ascontiguousarray(triangles[:, ::-1])
    points = np.ascontiguousarray(points[:, order])
    origin = np.array([grid.origin[a] for a in order])
    spacing = np.array([grid.spacing[a] for a in order])
    n_ray, n_row, n_layer = (grid.shape[a] for a in order)
    starts, listed = _list_by_chunks(points, triangles, origin[2], spacing[2], n_layer, _CHUNK)
    return Scan(points, triangles, starts, listed, origin, spacing, (n_ray, n_row, n_layer))


def ray_crossings(scan: Scan, start: int, stop: int) -> Iterator[tuple[int, int, I64, I64]]:
    """Crossings of layers start <= k < stop, chunk by chunk: first layer, the one after the last, starts, and keys.

    The keys of row r are keys[starts[r] : starts[r + 1]], sorted; a key is twice the first sample behind the crossing,
    plus 1 if the ray enters there.
    """
    n_ray, n_row, _ = scan.shape
    while start < stop:
        chunk = start // _CHUNK
        last = min(stop, (chunk + 1) * _CHUNK)
        listed = scan.listed[scan.starts[chunk] : scan.starts[chunk + 1]]
        yield (
            start,
            last,
            *_crossings(scan.vertices, scan.faces, listed, scan.origin, scan.spacing, n_ray, n_row, start, last),
        )
        start = last


@jit
def _first_at(origin: float, spacing: float, start: int, stop: int, value: float) -> int:
    """The first sample start <= i < stop that is not below a value; `stop` if there is none."""
    guess = np.ceil((value - origin) / spacing)
    i = int(min(max(guess, float(start)), float(stop)))
    # the division may round across a sample; what counts are the coordinates of the samples
    while i > start and origin + (i - 1) * spacing >= value:
        i -= 1
    while i < stop and origin + i * spacing < value:
        i += 1
    return i


@jit
def _list_by_chunks(
    vertices: F64, faces: I32, origin: float, spacing: float, n_layer: int, chunk: int
) -> tuple[I64, I32]:
    n_chunks = (n_layer + chunk - 1) // chunk
    span = np.empty((faces.shape[0], 2), np.int32)
    starts = np.zeros(n_chunks + 1, np.int64)
    for f in range(faces.shape[0]):
        a, b, c = vertices[faces[f, 0], 2], vertices[faces[f, 1], 2], vertices[faces[f, 2], 2]
        low = _first_at(origin, spacing, int(np.int64(0)), n_layer, min(a, b, c))
        high = _first_at(origin, spacing, int(np.int64(0)), n_layer, max(a, b, c))
        span[f, 0] = low // chunk
        span[f, 1] = (high + chunk - 1) // chunk if high > low else low // chunk
        for i in range(span[f, 0], span[f, 1]):
            starts[i + 1] += 1
    for i in range(n_chunks):
        starts[i + 1] += starts[i]
    at = starts.copy()
    listed = np.empty(starts[n_chunks], np.int32)
    for f in range(faces.shape[0]):
        for i in range(span[f, 0], span[f, 1]):
            listed[at[i]] = f
            at[i] += 1
    return starts, listed


@jit
def _sort_short(values: I64, start: int, stop: int) -> None:
    """Shell sort: rows have few crossings, and a part that is itself porous some hundreds."""
    n = stop - start
    gap = 1
    while 3 * gap + 1 < n:
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(start + gap, stop):
            value = values[i]
            j = i
            while j >= start + gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value
        gap //= 3


@jit
def _crossings(
    vertices: F64, faces: I32, listed: I32, origin: F64, spacing: F64, n_ray: int, n_row: int, first: int, last: int
) -> tuple[I64, I64]:
    """The starts and keys of `ray_crossings` for layers first <= k < last, of the triangles that are listed."""
    rows = np.empty(1024, np.int32)
    found = np.empty(1024, np.int64)
    n = 0
    starts = np.zeros((last - first) * n_row + 1, np.int64)
    for at in range(listed.size):
        face = faces[listed[at]]
        z0, z1, z2 = vertices[face[0], 2], vertices[face[1], 2], vertices[face[2], 2]
        k_low = _first_at(origin[2], spacing[2], first, last, min(z0, z1, z2))
        k_high = _first_at(origin[2], spacing[2], first, last, max(z0, z1, z2))
        for k in range(k_low, k_high):
            z = origin[2] + k * spacing[2]
            y_up, x_up, y_down, x_down = 0.0, 0.0, 0.0, 0.0
            for corner in range(3):
                p = face[corner]
                q = face[(corner + 1) % 3]
                p_below = vertices[p, 2] <= z
                if p_below == (vertices[q, 2] <= z):
                    continue
                # from the lower end to the upper one, whichever triangle of the edge is at work: the same rounding
                if not p_below:
                    p, q = q, p
                share = (z - vertices[p, 2]) / (vertices[q, 2] - vertices[p, 2])
                y = vertices[p, 1] + share * (vertices[q, 1] - vertices[p, 1])
                x = vertices[p, 0] + share * (vertices[q, 0] - vertices[p, 0])
                if p_below:
                    y_up, x_up = y, x
                else:
                    y_down, x_down = y, x
            j_up = _first_at(origin[1], spacing[1], int(np.int64(0)), n_row, y_up)
            j_down = _first_at(origin[1], spacing[1], int(np.int64(0)), n_row, y_down)
            # with outward winding the sense in which rows are passed distinguishes entry from exit
            entering = 1 if j_up < j_down else 0
            j_stop = max(j_up, j_down)
            for j in range(min(j_up, j_down), j_stop):
                share = (origin[1] + j * spacing[1] - y_down) / (y_up - y_down)
                x = x_down + share * (x_up - x_down)
                # rounding may not carry the crossing out of the triangle
                x = min(max(x, min(x_up, x_down)), max(x_up, x_down))
                if n == found.size:
                    more_rows = np.empty(2 * n, np.int32)
                    more_found = np.empty(2 * n, np.int64)
                    # element by element: an array assigned to a slice costs two seconds of compilation
                    for i in range(n):
                        more_rows[i] = rows[i]
                        more_found[i] = found[i]
                    rows = more_rows
                    found = more_found
                row = (k - first) * n_row + j
                rows[n] = row
                # the lowest bit holds the sign, so that one sort keeps both
                found[n] = 2 * _first_at(origin[0], spacing[0], int(np.int64(0)), n_ray, x) + entering
                starts[row + 1] += 1
                n += 1
    for r in range(starts.size - 1):
        starts[r + 1] += starts[r]
    keys = np.empty(n, np.int64)
    free = starts.copy()
    for i in range(n):
        keys[free[rows[i]]] = found[i]
        free[rows[i]] += 1
    for r in range(starts.size - 1):
        if starts[r + 1] - starts[r] > 1:
            _sort_short(keys, starts[r], starts[r + 1])
    return starts, keys
