"""Void that opens nowhere, for drains and fills, and the longest way out of void that is open.

Places at which a part may be drilled: away from its edges, the holes that it has, and the build plate.

A drain enters along the normal of the surface. Candidates are spread over the surface by area; those near a sharp edge
of the mesh, a concave cylinder or cone (a bolt hole, a bore, the end of a slot), the lowest plane, or a mesh that is to
be kept clear are left out. Of the rest, the whole capsule is looked at: it must not come near another face of the part.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.components import find_components, paint_runs
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.method.part.chosen_faces import faces_within
from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.measures import components
from sppm_pipeline.services.mesh.rays import spread_points

CANDIDATES = 6000
"""Points of the surface that are tried: on a part of 60 cm2 one per mm2. More only take longer."""

SHARP_ANGLE = 40.0
"""Degrees between the normals of two triangles that meet in an edge to keep away from.

Between facets of cylinders of 12 or more faces (30 degrees and less) and chamfers (45). At twice the angle chamfers
do not count, at half of it coarse cylinders are all edges.
"""

FLAT_ANGLE = 0.5
"""Degrees below which two triangles are in one plane; cylinders of up to 720 faces bend more."""

TIP_ANGLE = 20.0
"""Degrees between triangles of one surface where it meets others at less than `SHARP_ANGLE`, such as a bore the cone at
its mouth. Cylinders of 18 faces and more bend less."""

MAX_NEIGHBORS = 12
"""Facets that bend away from one; a facet of a cylinder has two to four, the floor of a bore as many as that."""

THIN, THIN_ROUNDS = 1e-5, 8
"""Height of a triangle, over the size of the mesh, up to which its normal is taken from a neighbor, a heuristic, and
how many such triangles may lie side by side. Coordinates of 32 bits leave such slivers, and so do Booleans."""

CYLINDER_SPREAD = 0.02
"""Variance of the normals of a cylinder or cone along its axis; that of a ball is a third."""

QUARTER_TURN = 0.85
"""Length of the mean normal of a concave surface above which it turns by less than a third of a circle: a fillet."""


class Features(NamedTuple):
    """Features of a mesh that drains keep away from."""

    edges: F64  # (k, 3, 3), sharp edges, as triangles without an area
    holes: F64  # (n, 3, 3), triangles of concave cylinders and cones


def mesh_features(vertices: F64, faces: I32) -> Features:
    """Find the sharp edges and the holes of a mesh that is wound outwards."""
    # edges are found by place, as some formats give every triangle corners of its own
    points, numbers = np.unique(vertices, axis=0, return_inverse=True)
    faces = np.ascontiguousarray(numbers.reshape(-1)[faces], np.int32)
    corners = points[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice = np.linalg.norm(normals, axis=1)
    units = normals / np.maximum(twice, 1e-300)[:, None]
    opposite = adjacency(faces).opposite
    half = np.arange(len(opposite))
    mine, start, end = half // 3, faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    paired = opposite >= 0
    theirs = np.where(paired, opposite // 3, mine)
    along = points[end] - points[start]
    # the normal of a triangle without a height is noise: it has that of a triangle beyond its longer edges
    lengths = np.linalg.norm(along, axis=1).reshape(-1, 3)
    ranks = 3 * np.arange(len(faces))[:, None] + np.argsort(-lengths, axis=1, kind="stable")
    known = twice > THIN * np.ptp(points, axis=0).max(initial=0.0) * lengths.max(1, initial=0.0)
    for rank in (0, 1) * THIN_ROUNDS:
        beyond = theirs[ranks[:, rank]]
        taken = ~known & known[beyond]
        units[taken] = units[beyond[taken]]
        known |= taken
    cross = np.cross(units[mine], units[theirs])
    angle = np.degrees(np.arctan2(np.linalg.norm(cross, axis=1), (units[mine] * units[theirs]).sum(1)))
    whole = paired & known[mine] & known[theirs]
    sharp = (~paired | (whole & (angle > SHARP_ANGLE))) & (~paired | (half < opposite))
    edges = np.stack([points[start[sharp]], points[end[sharp]], points[end[sharp]]], axis=1)
    flat = whole & (angle <= FLAT_ANGLE)
    facet = _grouped(len(faces), mine[flat], theirs[flat])
    bent = whole & (angle > FLAT_ANGLE) & ((cross * along).sum(1) < 0)
    areas = np.bincount(facet, twice)
    in_hole = np.zeros(len(faces), np.bool_)
    for largest, outwards in ((SHARP_ANGLE, True), (TIP_ANGLE, True), (SHARP_ANGLE, False)):
        chosen = bent & (angle <= largest)
        pairs = np.unique(np.sort(np.stack([facet[mine[chosen]], facet[theirs[chosen]]], axis=1), axis=1), axis=0)
        beside = np.bincount(pairs.ravel(), minlength=len(areas))
        # a plane that runs out into a fillet is no part of it, nor is the floor of a bore with a round corner
        plane = (beside[pairs] == 1) & (areas[pairs] > 2 * areas[pairs[:, ::-1]]) | (beside[pairs] > MAX_NEIGHBORS)
        concave = np.zeros(len(areas), np.bool_)
        concave[pairs[~plane.any(1)]] = True
        joined = whole & concave[facet[mine]] & concave[facet[theirs]] & (angle <= largest)
        if not outwards:
            joined &= flat | bent
        group = _grouped(len(areas), facet[mine[joined]], facet[theirs[joined]])[facet]
        # The normals of a cylinder lie in a plane through the origin, those of a cone in one beside it: no variance
        # along the axis. The mean of a quarter of a circle has the length 0.90, that of a third 0.83, of a half 0.64,
        # of all 0.
        weights = np.maximum(np.bincount(group, twice), 1e-300)
        means = np.stack([np.bincount(group, twice * units[:, i]) for i in range(3)], axis=1) / weights[:, None]
        products = (twice * units[:, i] * units[:, j] for i in range(3) for j in range(3))
        spreads = np.stack([np.bincount(group, product) for product in products], axis=1) / weights[:, None]
        least, axes = np.linalg.eigh(spreads.reshape(-1, 3, 3) - means[:, :, None] * means[:, None, :])
        is_hole = (least[:, 0] < CYLINDER_SPREAD) & (np.linalg.norm(means, axis=1) < QUARTER_TURN)
        if not outwards:
            # bores that cross meet in edges that bend outwards; so do the bands around the inside of a ring, which are
            # shorter than half of their radius
            places = corners @ axes[group]
            low, high = np.full((2, len(weights), 3), np.inf)
            np.minimum.at(low, group, places.min(1))
            np.minimum.at(high, group, -places.max(1))
            spans = -(high + low)
            is_hole &= spans[:, 0] > spans.max(1) / 4
        in_hole |= concave[facet] & is_hole[group]
    return Features(edges, corners[in_hole])


def _grouped(count: int, one: NDArray[np.integer], other: NDArray[np.integer]) -> I32:
    """Number of the group of each of `count` things, where each of `one` belongs to that of `other`."""
    each = np.arange(count)
    first, second = np.concatenate([each, one]), np.concatenate([each, other])
    return components(np.stack([first, second, second], axis=1))[1][:count]


class Candidates(NamedTuple):
    """Points at which drains may open."""

    points: F64  # (n, 3), mm
    inwards: F64  # (n, 3), unit normals into the part
    radius: float  # of the drains, mm
    clear: float  # from their rims to what they keep away from, mm
    floor: float  # height of the build plate
    mouths_off: F64  # (k, 3, 3), triangles that the mouths of drains keep away from: sharp edges
    all_off: F64  # (k, 3, 3), triangles that all of a drain keeps away from
    zone: tuple[F64, float] | None  # triangles (n, 3, 3) that are to be kept out of, and how far, mm

    def keeps_clear(self, capsule: F64) -> bool:
        """Test whether all of a capsule (7,), from within the part to its mouth, is as far off as it should be."""
        a, b, reach = capsule[:3], capsule[3:6], self.radius + self.clear
        along = (b - a) / np.linalg.norm(b - a)
        # a round rim in a slanted face is lower than its middle
        lowest = min(a[2], b[2]) - self.radius * math.sqrt(max(0.0, 1 - along[2] ** 2))
        axis = a + np.linspace(0.0, 1.0, 17)[:, None] * (b - a)
        return bool(
            lowest >= self.floor + self.clear
            and not points_within(b[None], self.mouths_off, reach).any()
            and not points_within(axis, self.all_off, reach).any()
            and (self.zone is None or not points_within(axis, self.zone[0], self.radius + self.zone[1]).any())
        )


def drain_candidates(domain: SurfaceMesh, radius: float, clear: float, zone: tuple[F64, float] | None) -> Candidates:
    """The points of a part's surface where a round hole stays away from edges, holes, plate and zone.

    The mesh is wound outwards; `radius` is that of the hole, `clear` from its rim, mm; `zone` are triangles (n, 3, 3)
    to keep out of, and how far from its rim.
    """
    outer = domain.outer_surface
    triangles = domain.vertices[domain.faces] if outer is None else outer.triangles
    points, inwards, _ = spread_points(triangles, CANDIDATES)
    features, reach = mesh_features(domain.vertices, domain.faces), radius + clear
    floor = float(domain.lower[2])
    allowed = points[:, 2] >= floor + clear
    allowed &= ~points_within(points, features.edges, reach) & ~points_within(points, features.holes, reach)
    if zone is not None:
        allowed &= ~points_within(points, zone[0], radius + zone[1])
    return Candidates(points[allowed], inwards[allowed], radius, clear, floor, *features, zone)


def points_within(points: F64, triangles: F64, distance: float) -> Bools:
    """Test which points (n, 3) lie within a distance of triangles (k, 3, 3), (n,) bool."""
    each = np.repeat(np.arange(len(points), dtype=np.int32), 3).reshape(-1, 3)
    return faces_within(points, each, triangles, distance)


def borings(candidates: Candidates, traps: Traps, label: int, depths: F32, world: Grid, costs: F64) -> F64:
    """Capsules (n, 7) that lead from candidates straight into a trap, by rising length within solid plus costs.

    `depths`, (nz, ny, nx), is the distance from the surface of the part, positive inside, and `costs`, (n,), further
    costs of each candidate, both in mm. Along the axis the surface must be no nearer than the mouth, or than the radius
    and `clear`, so that no hole runs along below a face or ends before another; and outside the way must be free for a
    diameter.
    """
    h, radius, clear = world.spacing[0], candidates.radius, candidates.clear
    steps = np.arange(-2 * radius - h, float(np.linalg.norm(world.shape)) * h / 2, h / 2)
    at = candidates.points[:, None] + steps[None, :, None] * candidates.inwards[:, None]
    index = np.rint((at - np.array(world.origin)) / h).astype(np.int64)
    last = np.array(world.shape) - 1
    outside = ((index < 0) | (index > last)).any(2)
    x, y, z = np.moveaxis(np.clip(index, 0, last), 2, 0)
    found = traps.labels[z, y, x]
    found[outside] = 1
    depth = np.where(outside, -np.inf, depths[z, y, x])
    reached = (found == label) & (steps > 0)
    first = reached.argmax(1)
    within = (steps[None] > 0) & (steps[None] <= (steps[first] + radius)[:, None])
    slack = 1.5 * h  # of a distance between voxels
    # A drain must not begin below an overhang or in a narrow gap: there its mouth would be another face.
    free = np.where(steps < 0, depth <= -np.minimum(-steps, radius) + slack, True).all(1)
    deep = np.where(within, depth >= np.minimum(steps, radius + clear) - slack, True).all(1)
    through = ((found == 0) & within & (np.arange(len(steps)) < first[:, None])).sum(1) * h / 2
    chosen = np.flatnonzero(reached.any(1) & free & deep & np.isfinite(costs))
    chosen = chosen[np.argsort((through + costs)[chosen], kind="stable")]
    points, inwards = candidates.points[chosen], candidates.inwards[chosen]
    inner = points + inwards * (steps[first[chosen]] + h)[:, None]
    return np.concatenate([inner, points - inwards * h, np.full((len(chosen), 1), radius)], axis=1)


def signed_depths(inside: U8, spacing: float) -> F32:
    """Distance of voxels (nz, ny, nx) from the surface of what is inside, positive there."""
    from scipy.ndimage import distance_transform_edt

    found: F64 = distance_transform_edt(inside) - distance_transform_edt(1 - inside)
    return (spacing * (found - np.sign(found) / 2)).astype(np.float32)


def loose_voxels(sizes: I64) -> int:
    """Voxels of all components but the largest."""
    return int(sizes.sum() - sizes.max(initial=0))


def unit(direction: tuple[float, float, float]) -> F64:
    """A direction as a vector of length 1."""
    return np.array(direction) / math.sqrt(sum(a * a for a in direction))


AMBIENT = 1
"""Label of all void that reaches the border of the grid."""


class Traps(NamedTuple):
    """Void that opens nowhere, the largest component first."""

    labels: I32  # (nz, ny, nx): 0 in solid, `AMBIENT`, and 2, 3, ... in the traps
    sizes: I64  # (n,), voxels of each trap


def find_traps(solid: U8) -> Traps:
    """Components of the void (nz, ny, nx) that do not meet the border of the grid, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    number = np.where(closed, 1 + np.cumsum(closed), AMBIENT).astype(np.int32)
    labels = np.zeros(solid.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, number[found.of_run], labels)
    return Traps(labels, found.sizes[closed])


class SmallVoids(NamedTuple):
    """Void that opens nowhere and is small enough to be filled."""

    sizes: I64  # (n,), voxels of each, the largest first
    places: I32  # (n, 3), the first voxel of each, z, y, x
    runs: I32  # (m, 4), z, y, first x and last x of their runs
    left: I64  # (k,), voxels of the closed voids that are larger, the largest first


def find_small_voids(solid: U8, largest: float) -> SmallVoids:
    """Components of the void (nz, ny, nx) of up to `largest` voxels that do not meet the border, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    small = closed & (found.sizes <= largest)
    chosen = np.flatnonzero(small[found.of_run])
    z, y = np.divmod(np.searchsorted(found.runs.rows, chosen, "right") - 1, solid.shape[1])
    bounds = found.runs.bounds.reshape(-1, 2)[chosen]
    runs = np.stack([z, y, bounds[:, 0], bounds[:, 1] - 1], 1).astype(np.int32)
    _, first = np.unique(found.of_run[chosen], return_index=True)
    return SmallVoids(found.sizes[small], runs[first, :3], runs, found.sizes[closed & ~small])


class Depth:
    """The longest way for powder out of what is open; take in layers by `add`, then ask `longest`.

    A block, of `block` voxels along its edge, is open if any of its voxels is, which keeps passages that are thinner
    than a block. Ways go along the axes, from block to block across faces, and end where the image does, on all six
    sides. `shape` is (nx, ny).
    """

    def __init__(self, shape: tuple[int, int], block: int) -> None:
        self._x, self._y = (np.arange(0, n, block) for n in shape)
        self._block = block
        self._sheet = np.zeros((len(self._y), len(self._x)), np.uint8)
        self._taken = 0
        self._done: list[U8] = []

    def add(self, layer: U8) -> None:
        """Take in the next layer, (ny, nx), 1 where it is open."""
        rows = np.maximum.reduceat(layer, self._y, axis=0)
        np.maximum(self._sheet, np.maximum.reduceat(rows, self._x, axis=1), out=self._sheet)
        self._taken += 1
        if self._taken == self._block:
            self._end_sheet()

    def _end_sheet(self) -> None:
        self._done.append(self._sheet.copy())
        self._sheet[:] = 0
        self._taken = 0

    def longest(self) -> int:
        """Voxels along the longest of the shortest ways out, to within two blocks; 0 if nothing is open."""
        if self._taken:
            self._end_sheet()
        return _farthest(np.stack(self._done)) * self._block if self._done else 0


@jit
def _farthest(open_: U8) -> int:
    """Steps from the border to the farthest open block that is reached; blocks that are reached are closed."""
    nz, ny, nx = open_.shape
    flat = open_.ravel()
    front = np.empty(flat.size, np.int32)
    n = 0
    for i in range(flat.size):
        z, y, x = i // (ny * nx), i // nx % ny, i % nx
        if flat[i] and (min(z, y, x) == 0 or z == nz - 1 or y == ny - 1 or x == nx - 1):
            front[n] = i
            n += 1
            flat[i] = 0
    # breadth-first search from all of the border at once: front[first:last] are the blocks of one
    # distance
    steps = first = 0
    while True:
        last = n
        for at in range(first, last):
            i = front[at]
            z, y, x = i // (ny * nx), i // nx % ny, i % nx
            for side in range(6):
                sign = 2 * (side % 2) - 1
                w, v, u = z + sign * (side // 2 == 0), y + sign * (side // 2 == 1), x + sign * (side // 2 == 2)
                if 0 <= w < nz and 0 <= v < ny and 0 <= u < nx:
                    other = (w * ny + v) * nx + u
                    if flat[other]:
                        flat[other] = 0
                        front[n] = other
                        n += 1
        if n == last:
            return steps
        steps += 1
        first = last
