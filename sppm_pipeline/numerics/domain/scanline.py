"""Which voxels are inside a mesh: signed scanlines.

Rays run along the rows of a grid. A ray that enters the solid counts +1, one that leaves -1, and a sample is inside
where the sum so far is positive; so shells that overlap are united, where an even-odd rule would cut them out.

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
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.bit_rows import fill_span, words_of
from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.grid import Grid

_CHUNK = 16  # layers that share one list of triangles


def as_mesh(vertices: ArrayLike, faces: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A mesh in the types that the kernels are compiled for.

    Parameters
    ----------
    vertices : (n, 3) floats
    faces : (m, 3) integers
        Indices of vertices.

    Returns
    -------
    vertices : (n, 3) float64, C-contiguous
    faces : (m, 3) int32, C-contiguous

    Raises
    ------
    InputError
        If a coordinate is not finite or an index names no vertex.
    ValueError
        If the shapes are wrong.
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
    """A mesh made ready for scanning; coordinates are in the order ray, row, layer.

    Attributes
    ----------
    vertices : (n, 3) float64
    faces : (m, 3) int32
    starts : (chunks + 1,) int64
        The triangles that may cut the layers of chunk c are listed from starts[c] to starts[c + 1].
    listed : (starts[-1],) int32
    origin, spacing : (3,) float64
        Of the samples.
    shape : tuple of 3 ints
        Samples along ray, row, layer.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]
    starts: NDArray[np.int64]
    listed: NDArray[np.int32]
    origin: NDArray[np.float64]
    spacing: NDArray[np.float64]
    shape: tuple[int, int, int]


class Occupancy(NamedTuple):
    """Some layers of an occupancy.

    Attributes
    ----------
    mask : (nz, ny, nx) uint8
        1 inside.
    crossed_rays : int
        Rays that meet the mesh.
    open_rays : int
        How many of them do not leave as often as they enter. 0 for a closed mesh that is wound consistently; the
        caller decides from the fraction what is still acceptable.
    undecided : int
        Voxels about which rays or winding number are not of one mind.
    """

    mask: NDArray[np.uint8]
    crossed_rays: int
    open_rays: int
    undecided: int = 0


def prepare_scan(vertices: ArrayLike, faces: ArrayLike, grid: Grid, axis: int = 0) -> Scan:
    """Sort the triangles of a mesh by layers.

    Parameters
    ----------
    vertices : (n, 3) floats
        In the unit of the grid. Vertices need not be merged.
    faces : (m, 3) integers
        Wound outwards.
    grid : Grid
        The samples (voxel centers) of the whole part.
    axis : {0, 1, 2}
        Direction of the rays. Rays along x make whole layers from contiguous rows.

    Returns
    -------
    Scan

    Raises
    ------
    InputError
        If a coordinate is not finite or an index names no vertex.
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


def scan_layers(scan: Scan, start: int, stop: int) -> Occupancy:
    """The occupancy of layers start <= k < stop, the same bit for bit however the part is cut into slabs.

    A ray that does not close is filled only where the count from either end says inside, so that a hole in the mesh
    does not leak to the end of the row.

    Parameters
    ----------
    scan : Scan
        With rays along x.
    start, stop : int

    Returns
    -------
    Occupancy
    """
    n_ray, n_row, n_layer = scan.shape
    if not 0 <= start <= stop <= n_layer:
        raise ValueError(f"layers {start} to {stop} are not among the {n_layer} of the grid")
    mask = np.zeros((stop - start, n_row, n_ray), dtype=np.uint8)
    crossed, opened = count_inside(scan, start, stop, 0, mask)
    return Occupancy(mask, crossed, opened)


def scan_bits(scan: Scan, start: int, stop: int) -> NDArray[np.uint64]:
    """The mask of `scan_layers` as bits, (stop - start, ny, words), see `numerics.bit_rows`."""
    n_ray, n_row, n_layer = scan.shape
    if not 0 <= start <= stop <= n_layer:
        raise ValueError(f"layers {start} to {stop} are not among the {n_layer} of the grid")
    bits = np.zeros((stop - start, n_row, words_of(n_ray)), np.uint64)
    for first, last, starts, keys in _by_chunks(scan, start, stop):
        _fill_bits(starts, keys, n_ray, bits[first - start : last - start].reshape(-1, bits.shape[2]))
    return bits


def _by_chunks(scan: Scan, start: int, stop: int) -> Iterator[tuple[int, int, NDArray[np.int64], NDArray[np.int64]]]:
    """First layer, the one after the last, and the crossings of `_crossings`, chunk by chunk."""
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


def count_inside(
    scan: Scan,
    start: int,
    stop: int,
    ray_start: int,
    out: NDArray[np.uint8],
    *,
    ballots: bool = False,
    parity: bool = False,
) -> tuple[int, int]:
    """Scan some layers into an array.

    Parameters
    ----------
    scan : Scan
    start, stop : int
        Layers of the scan (along the axis that is its third).
    ray_start : int
        The first sample along the ray that `out` holds.
    out : (stop - start, rows, samples along the ray) uint8
        Gets 1 where the counts from both ends of the ray say inside.
    ballots : bool
        Instead add to `out`: two where both ends say inside, one where one of them does.
    parity : bool
        Inside is where the number of crossings, whatever their sign, is odd.

    Returns
    -------
    crossed_rays, open_rays : int
    """
    crossed = opened = 0
    for first, last, starts, keys in _by_chunks(scan, start, stop):
        part, out = out[: last - first], out[last - first :]
        more_crossed, more_opened = _fill(starts, keys, ray_start, part, ballots, parity)
        crossed += more_crossed
        opened += more_opened
    return crossed, opened


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
    vertices: NDArray[np.float64], faces: NDArray[np.int32], origin: float, spacing: float, n_layer: int, chunk: int
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
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
def _sort_short(values: NDArray[np.int64], start: int, stop: int) -> None:
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
    vertices: NDArray[np.float64],
    faces: NDArray[np.int32],
    listed: NDArray[np.int32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    n_ray: int,
    n_row: int,
    first: int,
    last: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The crossings of all rays of layers first <= k < last, sorted along each ray.

    Returns (starts, keys): those of row r are keys[starts[r] : starts[r + 1]], and a key is twice the first sample
    behind the crossing, plus 1 if the ray enters there.
    """
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
            entering = 1 if j_up < j_down else 0
            j_stop = max(j_up, j_down)
            for j in range(min(j_up, j_down), j_stop):
                share = (origin[1] + j * spacing[1] - y_down) / (y_up - y_down)
                x = x_down + share * (x_up - x_down)
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


@jit
def _fill(
    starts: NDArray[np.int64],
    keys: NDArray[np.int64],
    ray_start: int,
    out: NDArray[np.uint8],
    ballots: bool,
    parity: bool,
) -> tuple[int, int]:
    _, n_row, width = out.shape
    crossed = 0
    opened = 0
    for r in range(starts.size - 1):
        if starts[r] == starts[r + 1]:
            continue
        row = out[r // n_row, r % n_row]
        crossed += 1
        total = 0
        for i in range(starts[r], starts[r + 1]):
            total += 1 if parity or keys[i] & 1 else -1
        if (parity and total & 1) or (not parity and total != 0):
            opened += 1
        # between two crossings, `count` is the sum so far and `total - count` the sum that is still to come
        count = 0
        begin = 0
        for i in range(starts[r], starts[r + 1] + 1):
            end = width
            if i < starts[r + 1]:
                end = min(max((keys[i] >> 1) - ray_start, 0), width)
            if parity:
                votes = (count & 1) + ((total - count) & 1)
            else:
                votes = int(count > 0) + int(count > total)
            if begin < end:
                if ballots:
                    if votes > 0:
                        for x in range(begin, end):
                            row[x] += np.uint8(votes)
                elif votes == 2:
                    row[begin:end] = 1
            begin = max(begin, end)
            if i < starts[r + 1]:
                count += 1 if parity or keys[i] & 1 else -1
    return crossed, opened


@jit
def _fill_bits(starts: NDArray[np.int64], keys: NDArray[np.int64], width: int, out: NDArray[np.uint64]) -> None:
    """Set what the counts from both ends of the ray call inside; as `_fill`, of which this is the common case."""
    for r in range(starts.size - 1):
        total = 0
        for i in range(starts[r], starts[r + 1]):
            total += 1 if keys[i] & 1 else -1
        count = begin = 0
        for i in range(starts[r], starts[r + 1] + 1):
            end = min(keys[i] >> 1, width) if i < starts[r + 1] else width
            if begin < end:
                if count > 0 and count > total:
                    fill_span(out[r], begin, end)
                begin = end
            if i < starts[r + 1]:
                count += 1 if keys[i] & 1 else -1
