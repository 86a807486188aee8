"""Measures of a triangle mesh: closedness, topology, volume and area. Any mesh is taken, also a broken one."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I32, I64, U64, Bools
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.paging import blocks
from sppm_pipeline.services.union_find import find_root, unite

T = TypeVar("T", bound=np.generic)

#: A triangle counts as degenerate if its height over the longest edge is at most this fraction of that edge.
FLAT = 1e-12

#: Lists of edges longer than this are not left to the insertion sort.
_LONG = 32

_NO_RIMS, _NO_SHIFT = np.empty((0, 3)), np.zeros(3)
_NO_RIMS.flags.writeable = False

#: Triangles whose corners are looked up at a time.
_AT_A_TIME = 2**18


class EdgeCounts(NamedTuple):
    """The edges of a mesh, whichever way they run.

    Attributes
    ----------
    edges : int
        Different edges.
    boundary : int
        Edges of one triangle: the boundaries of holes.
    non_manifold : int
        Edges of three or more triangles.
    unbalanced : int
        Edges that do not run as often in one direction as in the other: at boundaries, and where the winding flips.
    """

    edges: int
    boundary: int
    non_manifold: int
    unbalanced: int

    @property
    def closed(self) -> bool:
        """True if each directed edge and its opposite occur exactly once (a closed, oriented surface)."""
        return self.edges > 0 and self.non_manifold == 0 and self.unbalanced == 0

    @property
    def consistent(self) -> bool:
        """True if neighbors turn the same way wherever two triangles meet (boundaries are allowed)."""
        return self.non_manifold == 0 and self.unbalanced == self.boundary

    @property
    def bounds_solid(self) -> bool:
        """True if the mesh bounds a volume: the edges are balanced, though several sheets may meet in one."""
        return self.edges > 0 and self.unbalanced == 0


class SurfaceMeasures(NamedTuple):
    """The result of `measure_surface`; lengths in the unit of the vertices."""

    vertices: int  # that a triangle uses
    faces: int
    edges: EdgeCounts
    components: int
    euler: int
    genus: int | None  # None unless the surface is closed
    volume: float
    area: float
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    degenerate: int


def edge_counts(faces: NDArray[np.integer]) -> EdgeCounts:
    """Count the edges of triangles (m, 3); a triangle that names a vertex twice makes the mesh unbalanced."""
    keys, starts = _edge_keys(*_numbered(faces))
    for vertex in np.flatnonzero(np.diff(starts) > _LONG):
        keys[starts[vertex] : starts[vertex + 1]].sort()
    _insertion_sort(keys)  # the rest are short lists
    return EdgeCounts(*(int(count) for count in _count_runs(keys)))


def balanced_edges(faces: NDArray[np.integer]) -> bool:
    """True if every edge runs as often in one direction as in the other, as `EdgeCounts.bounds_solid` says.

    Found in one pass and without memory: each edge is hashed to 64 bits, counted positive in one direction and negative
    in the other, and the sum must vanish. A mesh that is not balanced passes with a probability of 2^-64.
    """
    numbered = read_only(np.ascontiguousarray(faces, np.int32))
    parts = [int(edge_balance(numbered[rows])) for rows in blocks(len(numbered), numbered)]
    return faces.size > 0 and sum(parts) % 2**64 == 0


def euler_number(faces: NDArray[np.integer]) -> int:
    """Vertices in use minus edges plus faces."""
    return int(np.count_nonzero(_used(faces))) - edge_counts(faces).edges + int(faces.shape[0])


def components(faces: NDArray[np.integer]) -> tuple[int, I32]:
    """Parts of the mesh that share no vertex.

    Returns
    -------
    count : int
    labels : (m,) int32
        The part of each triangle, numbered in the order of their first triangles.
    """
    count, labels = _components(*_numbered(faces))
    return int(count), labels


def genus(faces: NDArray[np.integer]) -> int:
    """Genus of a closed surface, all components together: components - Euler number / 2."""
    if not edge_counts(faces).closed:
        raise ValueError("only a closed surface has a genus")
    return components(faces)[0] - euler_number(faces) // 2


def volume(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Volume inside the mesh, (n, 3) and (m, 3); negative if it is inside out. Holes make it meaningless.

    By the divergence theorem, with the first corner as origin, so that a mesh far from the origin loses no digits.
    """
    return _volume_and_area(vertices, faces)[0]


def surface_area(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> float:
    """Sum of the areas of the triangles."""
    return _volume_and_area(vertices, faces)[1]


def bounds(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> tuple[F64, F64]:
    """Lowest and highest corner, (3,) each, of the box around the triangles; vertices without triangle are ignored."""
    return box_and_volume(vertices, faces)[:2]


def box_and_volume(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> tuple[F64, F64, float]:
    """`bounds` and `volume` in one pass."""
    if faces.size == 0:
        raise ValueError("a mesh without triangles has no bounds")
    found = _sums_of(vertices, faces)
    return found[3:6].copy(), found[6:].copy(), float(found[0])


def measure_surface(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> SurfaceMeasures:
    """All measures of a mesh, (n, 3) and (m, 3), in one pass.

    Raises
    ------
    ValueError
        If there is no triangle.
    """
    low, high = bounds(vertices, faces)
    edges = edge_counts(faces)
    used = int(np.count_nonzero(_used(faces)))
    parts = components(faces)[0]
    euler = used - edges.edges + int(faces.shape[0])
    inside, area, flat = _volume_and_area(vertices, faces)
    return SurfaceMeasures(
        vertices=used,
        faces=int(faces.shape[0]),
        edges=edges,
        components=parts,
        euler=euler,
        genus=parts - euler // 2 if edges.closed else None,
        volume=inside,
        area=area,
        low=(float(low[0]), float(low[1]), float(low[2])),
        high=(float(high[0]), float(high[1]), float(high[2])),
        degenerate=flat,
    )


def _named(faces: NDArray[np.integer]) -> int:
    """The number of vertices that triangles, at least one, may name."""
    ends = [(int(faces[rows].min()), int(faces[rows].max())) for rows in blocks(len(faces), faces)]
    low, high = min(end[0] for end in ends), max(end[1] for end in ends)
    if low < 0 or high >= 2**31:
        raise ValueError(f"vertex numbers run from 0 to 2^31 - 1, not from {low} to {high}")
    return high + 1


def _numbered(faces: NDArray[np.integer]) -> tuple[I32, int]:
    """The triangles as compiled code needs them (it checks no index), and the number of vertices they may name."""
    if faces.size == 0:
        return read_only(np.empty((0, 3), np.int32)), 0
    return read_only(np.ascontiguousarray(faces, np.int32)), _named(faces)


def read_only(array: NDArray[T]) -> NDArray[T]:
    """A view that is not to be written to: Numba would compile once more for arrays that can be."""
    view = array.view()
    view.flags.writeable = False
    return view


def _used(faces: NDArray[np.integer]) -> Bools:
    if faces.size == 0:
        return np.zeros(0, np.bool_)
    used = np.zeros(_named(faces), np.bool_)
    for start in range(0, len(faces), _AT_A_TIME):
        used[faces[start : start + _AT_A_TIME]] = True  # indices are copied, and wider
    return used


def _volume_and_area(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> tuple[float, float, int]:
    if faces.size == 0:
        return 0.0, 0.0, 0
    found = _sums_of(vertices, faces)
    return float(found[0]), float(found[1]), int(found[2])


def _sums_of(vertices: NDArray[np.floating], faces: NDArray[np.integer]) -> F64:
    """Volume, area, flat triangles, and low and high corner, (9,), of a mesh with at least one triangle."""
    points = read_only(np.ascontiguousarray(vertices, np.float64))
    numbered, n = _numbered(faces)
    if n > points.shape[0]:
        raise ValueError(f"a triangle names vertex {n - 1}, but there are only {points.shape[0]}")
    found = nothing_found()
    start = points[numbered[0, 0]].copy()
    for rows in blocks(len(numbered), points, numbered):
        add_sums(points, 0, numbered[rows], _NO_RIMS, 1.0, _NO_SHIFT, start, found)
    found[:2] /= (6.0, 2.0)
    return found


def nothing_found() -> F64:
    """Initial value of `add_sums`."""
    return np.concatenate([np.zeros(3), np.full(3, np.inf), np.full(3, -np.inf)])


@jit
def _edge_keys(faces: I32, n: int) -> tuple[U64, I64]:
    """Smaller and larger vertex of each edge in one number, with the direction in the lowest bit.

    The keys come sorted by the smaller vertex; those of vertex a begin at starts[a].
    """
    starts = np.zeros(n + 1, np.int64)
    for i in range(faces.shape[0]):
        for c in range(3):
            starts[min(faces[i, c], faces[i, (c + 1) % 3]) + 1] += 1
    for a in range(n):
        starts[a + 1] += starts[a]
    ends = starts.copy()
    keys = np.empty(3 * faces.shape[0], np.uint64)
    for i in range(faces.shape[0]):
        for c in range(3):
            a, b = faces[i, c], faces[i, (c + 1) % 3]
            low = min(a, b)
            keys[ends[low]] = np.uint64(low * n + max(a, b)) << np.uint64(1) | np.uint64(a > b)
            ends[low] += 1
    return keys, starts


@jit
def edge_balance(faces: I32) -> np.uint64:
    """Summands of `balanced_edges`, modulo 2^64."""
    total = np.uint64(0)
    for i in range(faces.shape[0]):
        for c in range(3):
            # points on rims may have negative numbers
            a, b = np.uint32(faces[i, c]), np.uint32(faces[i, (c + 1) % 3])
            key = np.uint64(min(a, b)) << np.uint64(32) | np.uint64(max(a, b))
            # the finisher of SplitMix64 (Steele, Lea and Flood, 2014)
            key += np.uint64(0x9E3779B97F4A7C15)
            key = (key ^ (key >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            key = (key ^ (key >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            key ^= key >> np.uint64(31)
            total = total + key if a < b else total - key
    return total


@jit
def _insertion_sort(keys: U64) -> None:
    for i in range(1, keys.size):
        key = keys[i]
        j = i
        while j > 0 and keys[j - 1] > key:
            keys[j] = keys[j - 1]
            j -= 1
        keys[j] = key


@jit
def _count_runs(keys: U64) -> tuple[int, int, int, int]:
    edges, boundary, several, unbalanced = 0, 0, 0, 0
    i = 0
    while i < keys.size:
        edge = keys[i] >> np.uint64(1)
        uses, backward = 0, 0
        while i < keys.size and keys[i] >> np.uint64(1) == edge:
            uses += 1
            backward += int(np.int64(keys[i] & np.uint64(1)))
            i += 1
        edges += 1
        boundary += uses == 1
        several += uses > 2
        unbalanced += 2 * backward != uses
    return edges, boundary, several, unbalanced


@jit
def _components(faces: I32, n: int) -> tuple[int, I32]:
    """Union-find over the vertices; the smaller root wins, so that the labels do not depend on how it went."""
    parent = np.arange(n)
    for i in range(faces.shape[0]):
        for c in range(1, 3):
            unite(parent, faces[i, 0], faces[i, c])
    names = np.full(n, -1, np.int32)
    labels = np.empty(faces.shape[0], np.int32)
    count = 0
    for i in range(faces.shape[0]):
        a = find_root(parent, faces[i, 0])
        if names[a] < 0:
            names[a] = count
            count += 1
        labels[i] = names[a]
    return count, labels


@jit
def add_sums(points: F64, base: int, faces: I32, rims: F64, scale: float, origin: F64, start: F64, found: F64) -> None:
    """Add six volumes, two areas and the flat triangles to what was found, and widen the box.

    `points` begin with vertex number `base`; a corner -1 - p lies at ``rims[p] * scale + origin``.
    """
    inside, area = found[0], found[1]
    flat = 0
    low_x, low_y, low_z, high_x, high_y, high_z = found[3], found[4], found[5], found[6], found[7], found[8]
    begin, corners = np.uint64(base), np.empty((3, 3))
    for i in range(faces.shape[0]):
        if (faces[i, 0] | faces[i, 1] | faces[i, 2]) < 0:
            for c in range(3):
                for axis in range(3):
                    v = np.int64(faces[i, c])
                    corners[c, axis] = rims[-1 - v, axis] * scale + origin[axis] if v < 0 else points[v - base, axis]
            ax, ay, az = corners[0, 0], corners[0, 1], corners[0, 2]
            bx, by, bz = corners[1, 0], corners[1, 1], corners[1, 2]
            cx, cy, cz = corners[2, 0], corners[2, 1], corners[2, 2]
        else:
            p, q, r = np.uint64(faces[i, 0]) - begin, np.uint64(faces[i, 1]) - begin, np.uint64(faces[i, 2]) - begin
            ax, ay, az = points[p, 0], points[p, 1], points[p, 2]
            bx, by, bz = points[q, 0], points[q, 1], points[q, 2]
            cx, cy, cz = points[r, 0], points[r, 1], points[r, 2]
        low_x, low_y, low_z = min(low_x, ax, bx, cx), min(low_y, ay, by, cy), min(low_z, az, bz, cz)
        high_x, high_y, high_z = max(high_x, ax, bx, cx), max(high_y, ay, by, cy), max(high_z, az, bz, cz)
        ux, uy, uz, vx, vy, vz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        twice = np.sqrt(nx * nx + ny * ny + nz * nz)
        wx, wy, wz = vx - ux, vy - uy, vz - uz
        longest2 = max(ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz)
        flat += not twice > FLAT * longest2
        area += twice
        inside += (ax - start[0]) * nx + (ay - start[1]) * ny + (az - start[2]) * nz
    found[0], found[1] = inside, area
    found[2] += flat
    found[3], found[4], found[5], found[6], found[7], found[8] = low_x, low_y, low_z, high_x, high_y, high_z
