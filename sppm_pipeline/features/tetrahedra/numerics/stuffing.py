"""Isosurface stuffing (Labelle and Shewchuk, 2007) inside a box whose faces stay planar and may repeat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError
from sppm_pipeline.features.tetrahedra.numerics.lattice import Crossings, find_crossings, repeat_low_faces
from sppm_pipeline.features.tetrahedra.numerics.quality import dihedral_extremes, volumes
from sppm_pipeline.features.tetrahedra.numerics.stencils import cut_tetrahedra
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.faces import components, face_neighbors

ANGLES = (10.7, 164.8)
"""Degrees; the paper's bounds of the dihedral angles, which halves of tetrahedra in the box are held to as well."""

MAX_CUBES = 2**24
"""Cubes of a lattice, at about 100 bytes each."""

MAX_TETRAHEDRA = 50_000_000
"""Tetrahedra of a mesh, at about 250 bytes each while it is made."""


class Stuffed(NamedTuple):
    """A tetrahedral mesh.

    Nodes are in units of the spacing of the grid, from the low corner of the box; those in a face of the box lie
    exactly in it, and copies on opposite faces of a periodic box are equal to the bit in the other coordinates. The
    twin of a node is the first of those that are its copies on opposite faces: the one on low faces, if it is in the
    mesh; itself for all others, and in a box that does not repeat.
    """

    nodes: NDArray[np.float64]  # (n, 3)
    tets: NDArray[np.int32]  # (m, 4), corners, of positive volume
    twins: NDArray[np.int32]  # (n,)
    put_back: int  # points in faces of the box that had to stay where they were for the sake of the angles


def stuff(values: NDArray[np.float32], periodic: bool, others: tuple[NDArray[np.float32], ...] = ()) -> Stuffed:
    """Fill the part of a box where a field is negative with tetrahedra.

    `values`, (2 nz + 1, 2 ny + 1, 2 nx + 1), are samples at the points of the lattice, as `doubled_grid` lays them, at
    least 4 cubes along each axis of a periodic box (else ValueError). If they are the maximum of several fields,
    `others` are these fields: the surface is then where, coming from the solid, the first of them reaches zero, which
    their maximum does not show. ResourceError if there are too many cubes or tetrahedra.
    """
    nz, ny, nx = (s // 2 for s in values.shape)
    if periodic and min(nx, ny, nz) < 4:
        raise ValueError(f"a periodic box needs 4 cubes along each axis, not {nx} x {ny} x {nz}")
    require_room(nx, ny, nz)
    # twelve for each cube, which has a corner and a center to itself
    expected = 6 * int(np.count_nonzero(values < 0))
    if expected > MAX_TETRAHEDRA:
        raise ResourceError(
            f"the solid would take about {expected} tetrahedra; the limit is {MAX_TETRAHEDRA}",
            hint="lower the resolution, or mesh a smaller piece",
        )
    found = find_crossings(values, periodic)
    fractions = _cut_positions(found.ends, others or (values,))
    top = (2 * nx, 2 * ny, 2 * nz)
    on_surface, moved = warp(found, fractions, top, periodic)
    signs = np.sign(values).astype(np.int8)
    np.negative(signs, out=signs)
    signs.ravel()[found.points[on_surface]] = 0
    if periodic:
        repeat_low_faces(signs)
    names = cut_tetrahedra(signs, found.slot_of, found.starts, found.incident, found.slots, periodic)
    del signs
    used, tets = _used(names, values.size + 8 * len(fractions))
    twins = _twins(used, values.shape, periodic)
    slot = _slot_of_nodes(used, found, values.shape, periodic)
    nodes = _positions(used, found, fractions, moved, slot, values.shape)
    put_back = 0
    while True:  # every round puts at least one point back, so that this ends
        has_moved = np.append(moved.any(1), False)[slot]
        tested = tets[has_moved[tets].any(1)]
        angles = dihedral_extremes(nodes, tested)
        poor = tested[(angles[:, 0] < ANGLES[0]) | (angles[:, 1] > ANGLES[1])]
        slots = np.unique(slot[poor[has_moved[poor]]])
        if not len(slots):
            return Stuffed(nodes / 2, tets, twins, put_back)
        put_back += len(slots)
        moved[slots] = 0
        nodes = _positions(used, found, fractions, moved, slot, values.shape)


def require_room(nx: int, ny: int, nz: int) -> None:
    """Raise `ResourceError` for a lattice of more cubes than can be dealt with."""
    if nx * ny * nz > MAX_CUBES:
        raise ResourceError(
            f"a lattice of {nx} x {ny} x {nz} cubes is too large; the limit is {MAX_CUBES} cubes",
            hint="lower the resolution, or mesh a smaller piece",
        )


def _cut_positions(ends: NDArray[np.int32], fields: tuple[NDArray[np.float32], ...]) -> NDArray[np.float64]:
    """Cut of each edge with the surface, by linear interpolation, as a fraction from the first end."""
    (x0, y0, z0), (x1, y1, z1) = ends[:, 0].T, ends[:, 1].T
    solid_first = np.ones(len(ends), np.bool_)
    for field in fields:
        solid_first &= field[z0, y0, x0] < 0
    from_solid = np.ones(len(ends))
    for field in fields:
        a, b = field[z0, y0, x0].astype(np.float64), field[z1, y1, x1].astype(np.float64)
        a, b = np.where(solid_first, a, b), np.where(solid_first, b, a)
        crosses = b > 0
        from_solid[crosses] = np.minimum(from_solid[crosses], a[crosses] / (a[crosses] - b[crosses]))
    return np.asarray(np.where(solid_first, from_solid, 1 - from_solid))


def _used(names: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """The names that occur, ascending, and the tetrahedra with the places of their corners among them."""
    number = np.zeros(count, np.int32)
    number[names] = 1
    used = np.flatnonzero(number)
    number[used] = np.arange(len(used), dtype=np.int32)
    return used, number[names]


def _coordinates(index: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Coordinates x, y, z of raveled indices."""
    return np.stack([index % shape[2], index // shape[2] % shape[1], index // (shape[1] * shape[2])], 1)


def _wrapped(index: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """The representative of points of the doubled grid of a periodic box."""
    at = _coordinates(index, shape) % (np.array(shape[::-1]) - 1)
    return np.asarray((at[:, 2] * shape[1] + at[:, 1]) * shape[2] + at[:, 0])


def _twins(used: NDArray[np.int64], shape: tuple[int, ...], periodic: bool) -> NDArray[np.int32]:
    if not periodic:
        return np.arange(len(used), dtype=np.int32)
    size = int(np.prod(shape))
    points = used < size
    original = used - (used - size) % 8
    original[points] = _wrapped(used[points], shape)
    return _first_alike(original)


def _first_alike(names: NDArray[np.integer]) -> NDArray[np.int32]:
    """For each name the place of the first that is equal to it."""
    _, first, inverse = np.unique(names, return_index=True, return_inverse=True)
    return np.asarray(first[inverse], np.int32)


def _slot_of_nodes(
    used: NDArray[np.int64], found: Crossings, shape: tuple[int, ...], periodic: bool
) -> NDArray[np.int32]:
    """For each node that is a point of the lattice, its number among those at cut edges; -1 for all others."""
    size = int(np.prod(shape))
    slot = np.full(len(used), -1, np.int32)
    points = used[used < size]
    slot[: len(points)] = found.slot_of.ravel()[_wrapped(points, shape) if periodic else points]
    return slot


def _positions(
    used: NDArray[np.int64],
    found: Crossings,
    fractions: NDArray[np.float64],
    moved: NDArray[np.float64],
    slot: NDArray[np.int32],
    shape: tuple[int, ...],
) -> NDArray[np.float64]:
    """Nodes in units of the doubled grid."""
    size = int(np.prod(shape))
    points = int(np.searchsorted(used, size))
    nodes = np.empty((len(used), 3))
    nodes[:points] = _coordinates(used[:points], shape)
    shifted = np.flatnonzero(slot >= 0)
    nodes[shifted] += moved[slot[shifted]]
    edge, copy = np.divmod(used[points:] - size, 8)
    ends = found.ends[edge].astype(np.float64)
    cut = ends[:, 0] + fractions[edge, None] * (ends[:, 1] - ends[:, 0])
    top = np.array(shape[::-1]) - 1
    for axis in range(3):
        high = (copy >> axis & 1).astype(bool)
        cut[high, axis] = top[axis]
    nodes[points:] = cut
    return nodes


def without_islands(mesh: Stuffed) -> tuple[Stuffed, float]:
    """The component of largest volume, connected across faces, also of a periodic box; the fraction removed."""
    count, labels = components(face_neighbors(mesh.twins[mesh.tets]))
    if count <= 1:
        return mesh, 0.0
    each = np.bincount(labels, volumes(mesh.nodes, mesh.tets), count)
    kept = int(np.argmax(each))
    tets = mesh.tets[labels == kept]
    used, corners = _used(tets, len(mesh.nodes))
    return Stuffed(mesh.nodes[used], corners, _first_alike(mesh.twins[used]), mesh.put_back), float(
        1 - each[kept] / each.sum()
    )


def expected_counts(surface: float, volume: float, porosity: float, resolution: float) -> tuple[float, float, float]:
    """Tetrahedra, corner nodes and boundary triangles to expect; area of the pores per volume, volume in cells.

    A cube of the body-centered lattice is worth twelve tetrahedra; the numbers at the surface were measured on the
    paper's cells. Quadratic tetrahedra have a node more on each edge, as many as Euler's formula says.
    """
    crossed = surface * volume * resolution**2
    tetrahedra = 12 * volume * (1 - porosity) * resolution**3 + crossed
    return tetrahedra, tetrahedra * (0.17 + 1.9 / resolution), 4.2 * crossed


TOO_CLOSE = np.array([np.nan, 0.45, 0.45, 0.41189, 0.24999])
"""Fraction of an edge below which the surface counts as too close to its end, by the squared length of the edge in the
doubled grid: 4 and 3 for the long and short edges of the lattice, with the paper's values; 2 and 1 for the half
diagonals of squares in the faces of the box and for the edges from their centers into the box."""

REACH_IN_FACE = 0.45
"""Fraction of an edge up to which a point in a face of the box is moved, if an edge leaving the face asks for it."""


def warp(
    crossings: Crossings, fractions: NDArray[np.float64], top: tuple[int, int, int], periodic: bool
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Warp lattice points onto the surface: which ones move, (s,), and by how much, (s, 3), in the doubled grid.

    A point in a face of the box moves in that face only, in an edge of the box along it. Where only edges that leave
    the face are cut too close to it, it is moved along one in the face that is cut within reach; failing that it stays
    where it is and counts as on the surface all the same. `fractions`, (e,), are where the surface cuts each edge, from
    its first end; `top` are the largest coordinates of the doubled grid, x, y, z.
    """
    steps = np.diff(crossings.ends, axis=1)[:, 0].astype(np.float64)
    squares = (steps**2).sum(1).astype(np.int64)
    nx, ny = top[0] + 1, top[1] + 1
    at = np.stack([crossings.points % nx, crossings.points // nx % ny, crossings.points // (nx * ny)], 1)
    fixed = (at == 0) | (at == np.array(top))
    # those that may move freely go first: what they take over, those in the faces need not approximate
    order = np.argsort(fixed.sum(1), kind="stable")
    on_surface = np.zeros(len(at), np.bool_)
    moved = np.zeros((len(at), 3))
    _warp(
        order, crossings.starts, crossings.incident, crossings.slots, fractions, steps, TOO_CLOSE[squares],
        np.sqrt(squares), fixed, on_surface, moved,
    )  # fmt: skip
    return on_surface, moved


@jit
def _warp(
    order: NDArray[np.int64], starts: NDArray[np.int64], incident: NDArray[np.int64], slots: NDArray[np.int32],
    fractions: NDArray[np.float64], steps: NDArray[np.float64], too_close: NDArray[np.float64],
    lengths: NDArray[np.float64], fixed: NDArray[np.bool_], on_surface: NDArray[np.bool_], moved: NDArray[np.float64],
) -> None:  # fmt: skip
    for s in order:
        close = False
        best, way, nearest = -1, 0.0, np.inf
        in_face = fixed[s, 0] or fixed[s, 1] or fixed[s, 2]
        for p in range(starts[s], starts[s + 1]):
            e = incident[p]
            first = slots[e, 0] == s
            if on_surface[slots[e, 1] if first else slots[e, 0]]:
                continue
            fraction = fractions[e] if first else 1.0 - fractions[e]
            close |= fraction < too_close[e]
            allowed = fraction < (REACH_IN_FACE if in_face else too_close[e])
            for axis in range(3):
                if fixed[s, axis] and steps[e, axis] != 0:
                    allowed = False
            if allowed and fraction * lengths[e] < nearest:
                best, way, nearest = e, (fraction if first else -fraction), fraction * lengths[e]
        if close:
            on_surface[s] = True
            if best >= 0:
                for axis in range(3):
                    moved[s, axis] = way * steps[best, axis]
