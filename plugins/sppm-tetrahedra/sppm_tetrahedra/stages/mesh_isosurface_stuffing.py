"""``mesh.isosurface_stuffing``: tetrahedra that fill the solid of a field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import Context, DesignError, Palette, Part, ScalarField, Size, Stage, option, options
from sppm_pipeline.errors import ResourceError
from sppm_pipeline.numerics import F32, F64, I32, I64, Bools, Grid, jit
from sppm_tetrahedra.numerics.faces import components, face_neighbors
from sppm_tetrahedra.numerics.lattice import (
    Crossings,
    cut_tetrahedra,
    doubled_grid,
    find_crossings,
    repeat_low_faces,
)
from sppm_tetrahedra.numerics.quality import dihedral_extremes, quality, volumes, with_mid_nodes
from sppm_tetrahedra.volume_mesh import VolumeMesh

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

    nodes: F64  # (n, 3)
    tets: I32  # (m, 4), corners, of positive volume
    twins: I32  # (n,)
    put_back: int  # points in faces of the box that had to stay where they were for the sake of the angles


def stuff(values: F32, periodic: bool, others: tuple[F32, ...] = ()) -> Stuffed:
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


def _cut_positions(ends: I32, fields: tuple[F32, ...]) -> F64:
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


def _used(names: I64, count: int) -> tuple[I64, I32]:
    """The names that occur, ascending, and the tetrahedra with the places of their corners among them."""
    number = np.zeros(count, np.int32)
    number[names] = 1
    used = np.flatnonzero(number)
    number[used] = np.arange(len(used), dtype=np.int32)
    return used, number[names]


def _coordinates(index: I64, shape: tuple[int, ...]) -> I64:
    """Coordinates x, y, z of raveled indices."""
    return np.stack([index % shape[2], index // shape[2] % shape[1], index // (shape[1] * shape[2])], 1)


def _wrapped(index: I64, shape: tuple[int, ...]) -> I64:
    """The representative of points of the doubled grid of a periodic box."""
    at = _coordinates(index, shape) % (np.array(shape[::-1]) - 1)
    return np.asarray((at[:, 2] * shape[1] + at[:, 1]) * shape[2] + at[:, 0])


def _twins(used: I64, shape: tuple[int, ...], periodic: bool) -> I32:
    if not periodic:
        return np.arange(len(used), dtype=np.int32)
    size = int(np.prod(shape))
    points = used < size
    original = used - (used - size) % 8
    original[points] = _wrapped(used[points], shape)
    return _first_alike(original)


def _first_alike(names: NDArray[np.integer]) -> I32:
    """For each name the place of the first that is equal to it."""
    _, first, inverse = np.unique(names, return_index=True, return_inverse=True)
    return np.asarray(first[inverse], np.int32)


def _slot_of_nodes(used: I64, found: Crossings, shape: tuple[int, ...], periodic: bool) -> I32:
    """For each node that is a point of the lattice, its number among those at cut edges; -1 for all others."""
    size = int(np.prod(shape))
    slot = np.full(len(used), -1, np.int32)
    points = used[used < size]
    slot[: len(points)] = found.slot_of.ravel()[_wrapped(points, shape) if periodic else points]
    return slot


def _positions(used: I64, found: Crossings, fractions: F64, moved: F64, slot: I32, shape: tuple[int, ...]) -> F64:
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
    stuffed = Stuffed(mesh.nodes[used], corners, _first_alike(mesh.twins[used]), mesh.put_back)
    return stuffed, float(1 - each[kept] / each.sum())


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


def warp(crossings: Crossings, fractions: F64, top: tuple[int, int, int], periodic: bool) -> tuple[Bools, F64]:
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
    order: I64, starts: I64, incident: I64, slots: I32, fractions: F64, steps: F64, too_close: F64, lengths: F64,
    fixed: Bools, on_surface: Bools, moved: F64,
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


@dataclass(frozen=True, kw_only=True)
class IsosurfaceStuffing(Stage):
    """Fill the solid with tetrahedra whose dihedral angles lie between 10.7 and 164.8 degrees.

    The box of a cell or tiling is kept: solid that reaches its faces ends there in a plane. Nodes on opposite faces
    of a periodic box are copies of each other. Edges of the mesh inside the solid are as long as a cube of the grid,
    or 0.87 of it; what is thinner is lost, and sharp edges of a part are rounded.
    """

    name: ClassVar[str] = "mesh.isosurface_stuffing"
    reported: ClassVar[tuple[str, ...]] = (
        "removed_share", "put_back", "minimum_dihedral_degrees", "maximum_dihedral_degrees", "maximum_radius_ratio",
    )  # fmt: skip

    resolution: int = options.resolution(32, note="here cubes of a lattice", minimum=4, maximum=512)
    islands: str = options.islands("auto", note="that is, solid that shares no face with the rest")
    order: int = option(
        1, help="1: straight tetrahedra; 2: quadratic, with a node in the middle of each edge", minimum=1, maximum=2
    )

    def estimate(self, palette: Palette, field: Size) -> Size:
        body, grid, n = field.body, field.grid(self.resolution), self.resolution
        tetrahedra, nodes, triangles = expected_counts(body.surface, body.volume, body.porosity, n)
        return Size(
            samples=2 * grid.samples, sums=2 * grid.sums, resident=grid.samples, tetrahedra=tetrahedra, nodes=nodes,
            mid_nodes=nodes + tetrahedra + triangles / 2 if self.order == 2 else 0.0,
            triangles=triangles, geometry=body,
        )  # fmt: skip

    def run(self, context: Context, field: ScalarField) -> VolumeMesh:
        """Sample the lattice and cut it; the mesh is in mm (cell sizes for a cell without a size)."""
        from sppm_pipeline.numerics import report_removal

        n, h = self.resolution, 1.0 / self.resolution
        if (coarse := field.coarseness(h)) is not None:
            context.warn(coarse)
        if field.edge_mm is None:
            context.warn("the cell has no physical size: one cell size is written as 1 mm")
        low, high = np.zeros(3, np.int64), np.array(field.cells) * n
        if isinstance(field, Part):
            edge = field.physical_edge()
            low = np.floor((field.domain.lower - field.origin_mm) / edge * n).astype(np.int64) - 1
            high = np.ceil((field.domain.upper - field.origin_mm) / edge * n).astype(np.int64) + 1
        nx, ny, nz = (int(v) for v in high - low)
        require_room(nx, ny, nz)
        sampled = _sampled(field, low, (nx, ny, nz), h, context.threads)
        grids = [doubled_grid(*one, field.periodic) for one in sampled]
        values = grids[0] if len(grids) == 1 else np.maximum(*grids)
        if not (values < 0).any():
            raise DesignError("there is no solid to mesh", hint="lower the porosity or the level, or refine the grid")
        made = stuff(values, field.periodic, tuple(grids) if len(grids) > 1 else ())
        if not len(made.tets):
            raise DesignError("the solid is too thin for this grid: nothing is left of it", hint="refine the grid")
        removed = 0.0
        if self.islands != "keep":
            made, removed = without_islands(made)
        report_removal(context, removed, self.islands, "a finer grid")
        context.report(put_back=made.put_back)
        scale, origin = field.edge_mm or 1.0, np.array(field.origin_mm)
        nodes, box = ((low + v) * h * scale + origin for v in (made.nodes, np.array([[0, 0, 0], [nx, ny, nz]])))
        shape = quality(nodes, made.tets)
        context.report(
            minimum_dihedral_degrees=shape.minimum_dihedral,
            maximum_dihedral_degrees=shape.maximum_dihedral,
            maximum_radius_ratio=shape.radius_ratio,
        )
        tets = made.tets
        if self.order == 2:
            nodes, tets = with_mid_nodes(nodes, tets)
        is_part = isinstance(field, Part)
        return VolumeMesh(nodes, tets, None if is_part else box, field.periodic, name="tetrahedra")


def _sampled(
    field: ScalarField, low: I64, shape: tuple[int, int, int], h: float, threads: int
) -> list[tuple[F32, F32, tuple[F32, F32, F32]]]:
    """The field, or both fields of a part, at the corners and centers of cubes, and at centers of squares in faces."""
    cells = np.array(shape)
    apart = field.apart_zyx if isinstance(field, Part) else lambda grid, threads: (field.sample(grid, threads).T,)

    def at(offset: F64, count: I64) -> tuple[F32, ...]:
        x, y, z = ((low + offset) * h).tolist()
        nx, ny, nz = count.tolist()
        return apart(Grid((x, y, z), (h, h, h), (nx, ny, nz)), threads)

    corners, centers = at(np.zeros(3), cells + 1), at(np.full(3, 0.5), cells)
    faces: list[list[F32]] = [[] for _ in corners]
    for axis in range(3):
        sides = []
        for side in (0, shape[axis]):
            offset, count = np.full(3, 0.5), cells.copy()
            offset[axis], count[axis] = side, 1
            # no solid reaches the box around a part
            void = (np.ones(count[::-1], np.float32),) * len(corners)
            sides.append(void if isinstance(field, Part) else at(offset, count))
        for one, low_side, high_side in zip(faces, *sides, strict=True):
            one.append(np.concatenate([low_side, high_side], axis=2 - axis))
    return [(c, m, (f[0], f[1], f[2])) for c, m, f in zip(corners, centers, faces, strict=True)]
