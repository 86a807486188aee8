"""Self-contact by split pinballs (Belytschko and Neal 1991; Belytschko and Yeh 1993).

A voxel at the surface carries up to eight balls, at half of the way from its center to its corners, next to its
exposed faces. Balls of voxels that are no neighbors repel each other when they overlap. The repulsion has a potential;
normal damping and Coulomb friction don't. As balls are carried by the shape functions, forces on them become forces on
corners by the same weights.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.numerics import contact
from sppm_crushing.numerics.body import Body
from sppm_pipeline.numerics import jit

Share = Callable[[int, Callable[[int, int], None]], None]
"""Lets threads work on about equal shares of so many things."""

_NONE, _NO_SHARE = np.zeros(0, np.int64), np.zeros(0)


class SelfContact:
    """The balls of a body's surface, the pairs of them that are near each other, and their forces.

    `stiffness` of contacts and `mass` of voxels are those of each phase. `points` are nodes that carry a ball each, of
    which `points_share` (points,) is the share of a voxel's mass, up to 1, and `points_phase` the phase. `pushed`
    (carriers,) says which voxels at the surface, and then points, are in contact; `push` (carriers, 8, 3) has the
    forces on `corners` (carriers, 8), which of a point are all the same.
    """

    def __init__(
        self, body: Body, stiffness: NDArray[np.float64], mass: NDArray[np.float64], friction: float, dt: float,
        share: Share, points: NDArray[np.int64] = _NONE, points_share: NDArray[np.float64] = _NO_SHARE,
        points_phase: NDArray[np.int64] = _NONE,
    ) -> None:  # fmt: skip
        self._body, self._friction, self._dt, self._share = body, friction, dt, share
        count = len(body.surface) + len(points)
        shape = (count, 8, 3)
        phases = np.concatenate([body.phases[body.surface], points_phase]).astype(np.int64)
        self.corners = np.concatenate([body.corners[body.surface], np.repeat(points[:, None], 8, 1)]).astype(np.uint32)
        # in half voxels, so that nodes have places, too; those of neighbors are no more than two apart
        self._places = np.concatenate([2 * body.voxels[body.surface] + 1, 2 * body.nodes[points]]).astype(np.int32)
        self._carried = np.concatenate([body.carried, np.ones(len(points), np.uint8)])
        shares = np.concatenate([np.ones(len(body.surface)), points_share])
        self._stiffness, self._mass = shares * stiffness[phases], shares * mass[phases]
        self._balls = [np.zeros(shape) for _ in range(3)]
        self._lossy, self.push = np.zeros(shape), np.zeros(shape)
        self.pushed = np.zeros(count, np.uint8)
        self._starts = np.zeros(8 * count + 1, np.int32)
        self._all = np.arange(count, dtype=np.int32)
        self._room = 64
        self._was_lost = 0.0
        self._sums = np.zeros((0, contact.SUMS))

    @property
    def stored(self) -> float:
        """Energy of all contacts."""
        return float(self._sums[:, 0].sum())

    @property
    def lost(self) -> float:
        """Energy lost to damping and friction of contacts."""
        return self._was_lost + float(self._sums[:, 1].sum())

    @lost.setter
    def lost(self, value: float) -> None:
        self._was_lost = value
        self._sums[:, 1] = 0

    def search(self, x: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Search the pairs that may come to touch, and what touches now, at positions and velocities (nodes, 3)."""
        self._was_lost = self.lost
        now, before, _ = self._balls
        self._place(x, v, now, self._all, 0.0)
        centers = now.mean(1)
        radii = np.sqrt(((now - centers[:, None]) ** 2).sum(2).max(1))
        width = contact.REACH + 2 * float(radii.max())
        # a piece that has flown off counts to the border of the grid
        origin = np.maximum(centers.min(0), [-n for n in self._body.shape])
        far = np.minimum(centers.max(0), [2 * n for n in self._body.shape])
        shape = np.maximum(np.floor((far - origin) / width).astype(np.int64), 0) + 1
        starts = np.zeros(int(np.prod(shape)) + 2, np.int32)
        names, points, homes = np.empty(len(now), np.int32), np.empty((len(now), 4)), np.empty((len(now), 3), np.int32)
        contact.sort_voxels(centers, radii, self._places, origin, width, shape, starts, names, points, homes)
        found: dict[int, NDArray[np.int32]] = {}

        def layers(first: int, last: int) -> None:
            room = 1 + self._room * (last - first)
            while True:
                pairs = np.empty((room, 2), np.int32)
                # how many pairs there are is known only afterwards: a second search has room for all
                count = contact.search(starts, names, points, homes, shape, first, last, now, self._carried, pairs)
                if count <= room:
                    found[first] = pairs[:count]
                    return
                room = count

        self._share(int(shape[2]), layers)
        pairs = np.concatenate([found[first] for first in sorted(found)])
        self._room = 1 + 2 * len(pairs) // int(shape[2])
        self._partners = np.empty(2 * len(pairs), np.int32)
        contact.list_partners(pairs, self._starts, self._partners)
        self._active = np.flatnonzero(np.diff(self._starts[::8])).astype(np.int32)
        self._sums = np.zeros((-(-len(self._active) // contact.CHUNK), contact.SUMS))
        self._place(x, v, before, self._active, self._dt)
        # losses need the balls two steps ago, which are not known of new pairs: the first step loses nothing
        self._lossy[:] = 0
        self.pushed[:] = 0
        self._repel()

    def follow(self, x: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Forces a step later."""
        if len(self._active):
            self._balls = [self._balls[2], self._balls[0], self._balls[1]]
            self._place(x, v, self._balls[0], self._active, 0.0)
            self._repel()

    def _place(
        self, x: NDArray[np.float64], v: NDArray[np.float64], balls: NDArray[np.float64], active: NDArray[np.int32],
        ago: float,
    ) -> None:  # fmt: skip
        self._share(len(active), lambda a, b: contact.place(x, v, ago, self.corners, active, a, b, balls))

    def _repel(self) -> None:
        now, before, earlier = self._balls

        def chunks(a: int, b: int) -> None:
            contact.repel(
                now, before, earlier, self._active, a, b, self._starts, self._partners, self._stiffness, self._mass,
                self._friction, self._dt, self._lossy, self.pushed, self.push, self._sums,
            )  # fmt: skip

        self._share(len(self._sums), chunks)


DIAMETER = 0.56
"""Of a ball, in voxel edges; two blocks then touch when their gap has closed to within a tenth of a voxel."""

REACH = 1.06
"""Distance of balls that are listed as candidates."""

SLACK = 0.22
"""Largest way of a node before candidates are searched again; less than half of what lies between diameter and reach,
by a share for the compression that all distances undergo meanwhile."""

STIFFNESS, STABLE = 0.25, 0.09
"""Stiffness of a contact over the wave modulus, or over the mass of a voxel by the squared step if that is less."""

HARDENING = 4.0
"""Share of the cubic term of the repulsion. Balls of opposite surfaces can slip between each other when their pressure
is beyond 0.3 of Young's modulus."""

DAMPING, DRAG = 0.05, 0.02
"""Share of critical damping along the line of centers, and of the momentum that friction may take in a step. Half as
much again of both, and blocks pressed on each other at a tenth of Young's modulus begin to tremble: they act on
velocities half a step old."""

#: What `repel` adds up for each chunk: stored in contacts, lost to damping and friction.
SUMS = 2
CHUNK = 128


@jit
def _split(p: NDArray[Any]) -> None:
    """Weigh the corners by 3/4 and 1/4 along each axis, in place."""
    for c in range(3):
        a0, a1, a2, a3, a4, a5, a6, a7 = p[0, c], p[1, c], p[2, c], p[3, c], p[4, c], p[5, c], p[6, c], p[7, c]
        d0, d1, d2, d3 = 0.25 * (a1 - a0), 0.25 * (a3 - a2), 0.25 * (a5 - a4), 0.25 * (a7 - a6)
        a0, a1, a2, a3, a4, a5, a6, a7 = a0 + d0, a1 - d0, a2 + d1, a3 - d1, a4 + d2, a5 - d2, a6 + d3, a7 - d3
        d0, d1, d2, d3 = 0.25 * (a2 - a0), 0.25 * (a3 - a1), 0.25 * (a6 - a4), 0.25 * (a7 - a5)
        a0, a1, a2, a3, a4, a5, a6, a7 = a0 + d0, a1 + d1, a2 - d0, a3 - d1, a4 + d2, a5 + d3, a6 - d2, a7 - d3
        d0, d1, d2, d3 = 0.25 * (a4 - a0), 0.25 * (a5 - a1), 0.25 * (a6 - a2), 0.25 * (a7 - a3)
        p[0, c], p[1, c], p[2, c], p[3, c] = a0 + d0, a1 + d1, a2 + d2, a3 + d3
        p[4, c], p[5, c], p[6, c], p[7, c] = a4 - d0, a5 - d1, a6 - d2, a7 - d3


@jit
def place(
    x: NDArray[Any], v: NDArray[Any], dt: float, corners: NDArray[Any], active: NDArray[Any], first: int, last: int,
    balls: NDArray[Any],
) -> None:  # fmt: skip
    """Write positions (voxels, 8, 3) of the balls of voxels `first` to `last` of `active`, a time `dt` ago."""
    for at in range(first, last):
        voxel = active[at]
        for a in range(8):
            n = corners[voxel, a]
            for c in range(3):
                balls[voxel, a, c] = x[n, c] - dt * v[n, c]
        _split(balls[voxel])


@jit
def sort_voxels(
    centers: NDArray[Any], radii: NDArray[Any], places: NDArray[Any], origin: NDArray[Any], width: float,
    shape: NDArray[Any], starts: NDArray[Any], names: NDArray[Any], points: NDArray[Any], homes: NDArray[Any],
) -> None:  # fmt: skip
    """Sort voxels into the cells, of this width, of a grid; `shape` counts its cells, and voxels beyond count to those
    at its border.

    `centers` (voxels, 3), `radii` (voxels,) to the farthest ball of each, `places` (voxels, 3) in the undeformed body.
    Written are `starts` (cells + 2,), zeros at first, where the voxels of each cell begin, and in the order of the
    cells `names` (voxels,), `points` (voxels, 4), centers with radii, and `homes` (voxels, 3), their places.
    """
    nx, ny, nz = shape
    cells = np.empty(len(centers), np.int32)
    for voxel in range(len(centers)):
        i = min(max(int((centers[voxel, 0] - origin[0]) / width), 0), nx - 1)
        j = min(max(int((centers[voxel, 1] - origin[1]) / width), 0), ny - 1)
        k = min(max(int((centers[voxel, 2] - origin[2]) / width), 0), nz - 1)
        cells[voxel] = i + nx * (j + ny * k)
        starts[cells[voxel] + 2] += 1
    # counting sort: starts are two ahead of counts, so that filling the cells leaves them where the cells begin
    for cell in range(1, len(starts)):
        starts[cell] += starts[cell - 1]
    for voxel in range(len(centers)):
        to = starts[cells[voxel] + 1]
        starts[cells[voxel] + 1] = to + 1
        names[to] = voxel
        points[to, 3] = radii[voxel]
        for c in range(3):
            points[to, c] = centers[voxel, c]
            homes[to, c] = places[voxel, c]


@jit
def search(
    starts: NDArray[Any], names: NDArray[Any], points: NDArray[Any], homes: NDArray[Any], shape: NDArray[Any],
    first: int, last: int, balls: NDArray[Any], carried: NDArray[Any], pairs: NDArray[Any],
) -> int:  # fmt: skip
    """List the pairs of balls within reach whose voxels are no neighbors, for the layers `first` to `last` of cells;
    returns their number, of which more than fit into `pairs` were not written.

    Arrays are those of `sort_voxels`; cells must be as wide as the largest distance of two voxels with balls within
    reach. A pair belongs to the lower of its two layers. `balls` (voxels, 8, 3), `carried` (voxels,) bits of the
    corners that have a ball; `pairs` (room, 2) receive eight times the voxel and the corner, in an order that the
    positions determine. Places are in half voxels: neighbors are up to two apart.
    """
    nx, ny, nz = shape
    found = 0
    for k in range(first, last):
        for j in range(ny):
            for i in range(nx):
                cell = i + nx * (j + ny * k)
                begin, end = starts[cell], starts[cell + 1]
                if begin == end:
                    continue
                for row in range(5):
                    # the rest of its own row, then the rows of which each pair is met once
                    dj, dk = (0, 1, -1, 0, 1)[row], (0, 0, 1, 1, 1)[row]
                    if j + dj < 0 or j + dj >= ny or k + dk >= nz:
                        continue
                    there = nx * (j + dj + ny * (k + dk))
                    low, high = starts[there + max(i - 1, 0)], starts[there + min(i + 1, nx - 1) + 1]
                    for one in range(begin, end):
                        x, y, z, reach = points[one, 0], points[one, 1], points[one, 2], REACH + points[one, 3]
                        hx, hy, hz = homes[one, 0], homes[one, 1], homes[one, 2]
                        p = names[one]
                        for other in range(one + 1 if row == 0 else low, high):
                            dx, dy, dz = points[other, 0] - x, points[other, 1] - y, points[other, 2] - z
                            near = dx * dx + dy * dy + dz * dz < (reach + points[other, 3]) ** 2
                            away = max(abs(homes[other, 0] - hx), abs(homes[other, 1] - hy), abs(homes[other, 2] - hz))
                            # one condition: most voxels nearby are neighbors, and two branches would be hard to guess
                            if not (near & (away > 2)):
                                continue
                            q = names[other]
                            x1, y1, z1, limit = x + dx, y + dy, z + dz, (REACH + points[other, 3]) ** 2
                            for a in range(8):
                                dx, dy, dz = balls[p, a, 0] - x1, balls[p, a, 1] - y1, balls[p, a, 2] - z1
                                near = dx * dx + dy * dy + dz * dz < limit
                                if not (near & (carried[p] >> a & 1 > 0)):
                                    continue
                                for b in range(8):
                                    dx, dy = balls[p, a, 0] - balls[q, b, 0], balls[p, a, 1] - balls[q, b, 1]
                                    dz = balls[p, a, 2] - balls[q, b, 2]
                                    near = dx * dx + dy * dy + dz * dz < REACH * REACH
                                    if near & (carried[q] >> b & 1 > 0):
                                        if found < len(pairs):
                                            pairs[found, 0], pairs[found, 1] = 8 * p + a, 8 * q + b
                                        found += 1
    return found


@jit
def list_partners(pairs: NDArray[Any], starts: NDArray[Any], partners: NDArray[Any]) -> None:
    """The partners of each ball, from pairs (n, 2): where they begin, (balls + 1,), and they themselves, (2 n,)."""
    starts[:] = 0
    for pair in range(len(pairs)):
        starts[pairs[pair, 0] + 1] += 1
        starts[pairs[pair, 1] + 1] += 1
    for ball in range(1, len(starts)):
        starts[ball] += starts[ball - 1]
    filled = starts[:-1].copy()
    for pair in range(len(pairs)):
        one, other = pairs[pair, 0], pairs[pair, 1]
        partners[filled[one]] = other
        filled[one] += 1
        partners[filled[other]] = one
        filled[other] += 1


@jit
def repel(
    balls: NDArray[Any], before: NDArray[Any], earlier: NDArray[Any], active: NDArray[Any], first: int, last: int,
    starts: NDArray[Any], partners: NDArray[Any], stiffness: NDArray[Any], mass: NDArray[Any], friction: float,
    dt: float, lossy: NDArray[Any], pushed: NDArray[Any], push: NDArray[Any], sums: NDArray[Any],
) -> None:  # fmt: skip
    """Forces of contact on the corners of the chunks `first` to `last` of `active` voxels, with balls that have
    partners.

    `balls`, `before` and `earlier` (voxels, 8, 3) are now, one step ago and two steps ago; `stiffness` and `mass`
    (voxels,) those of a contact and of a voxel, by its material. `lossy` (voxels, 8, 3) is damping and friction on
    each ball one step ago, and is replaced by those of now. Written are `pushed` (voxels,), whether anything touches,
    and where it does `push` (voxels, 8, 3). Of `sums` (chunks, SUMS) the energy stored in contacts is set; what the
    forces of one step ago have lost is added, by the mean velocity before and after them.
    """
    for chunk in range(first, last):
        stored, lost = 0.0, 0.0
        for at in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(active))):
            p = active[at]
            touches = False
            for a in range(8):
                one = 8 * p + a
                if starts[one] == starts[one + 1]:
                    continue
                x, y, z = balls[p, a, 0], balls[p, a, 1], balls[p, a, 2]
                fx, fy, fz, lx, ly, lz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for place in range(starts[one], starts[one + 1]):
                    q, b = partners[place] >> 3, partners[place] & 7
                    dx, dy, dz = x - balls[q, b, 0], y - balls[q, b, 1], z - balls[q, b, 2]
                    square = dx * dx + dy * dy + dz * dz
                    if square >= DIAMETER * DIAMETER:
                        continue
                    touches = True
                    distance = np.sqrt(square) + 1e-12
                    overlap = 1 - distance / DIAMETER
                    k = min(stiffness[p], stiffness[q])
                    # the reduced mass of two that are as light as the lighter one
                    m = 0.5 * min(mass[p], mass[q])
                    # derivative of the energy stored, of which each of the two balls counts half
                    spring = k * DIAMETER * (overlap + HARDENING * overlap**3)
                    stored += 0.5 * k * DIAMETER**2 * (0.5 * overlap**2 + 0.25 * HARDENING * overlap**4)
                    dx, dy, dz = dx / distance, dy / distance, dz / distance
                    vx = ((x - before[p, a, 0]) - (balls[q, b, 0] - before[q, b, 0])) / dt
                    vy = ((y - before[p, a, 1]) - (balls[q, b, 1] - before[q, b, 1])) / dt
                    vz = ((z - before[p, a, 2]) - (balls[q, b, 2] - before[q, b, 2])) / dt
                    vn = vx * dx + vy * dy + vz * dz
                    vx, vy, vz = vx - vn * dx, vy - vn * dy, vz - vn * dz
                    slip = np.sqrt(vx * vx + vy * vy + vz * vz) + 1e-30
                    # no more than the spring: contacts never pull
                    damper = min(max(-2 * DAMPING * np.sqrt(k * m) * vn, -spring), spring)
                    drag = min(friction * spring, DRAG * m * slip / dt) / slip
                    fx, fy, fz = fx + spring * dx, fy + spring * dy, fz + spring * dz
                    lx, ly, lz = (
                        lx + damper * dx - drag * vx, ly + damper * dy - drag * vy, lz + damper * dz - drag * vz,
                    )  # fmt: skip
                lost -= 0.5 * (
                    lossy[p, a, 0] * (x - earlier[p, a, 0])
                    + lossy[p, a, 1] * (y - earlier[p, a, 1])
                    + lossy[p, a, 2] * (z - earlier[p, a, 2])
                )
                lossy[p, a, 0], lossy[p, a, 1], lossy[p, a, 2] = lx, ly, lz
                push[p, a, 0], push[p, a, 1], push[p, a, 2] = fx + lx, fy + ly, fz + lz
            pushed[p] = touches
            if touches:
                for a in range(8):
                    if starts[8 * p + a] == starts[8 * p + a + 1]:
                        push[p, a, 0], push[p, a, 1], push[p, a, 2] = 0.0, 0.0, 0.0
                _split(push[p])
        sums[chunk, 0] = stored
        sums[chunk, 1] += lost
