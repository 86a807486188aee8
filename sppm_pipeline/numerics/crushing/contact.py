"""Self-contact by split pinballs (Belytschko and Neal 1991; Belytschko and Yeh 1993).

A voxel at the surface carries up to eight balls, at half of the way from its center to its corners, next to its exposed
faces. Balls of voxels that are no neighbors repel each other when they overlap. The repulsion has a potential; normal
damping and Coulomb friction don't. As balls are carried by the shape functions, forces on them become forces on
corners by the same weights.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

DIAMETER = 0.56
"""Of a ball, in voxel edges; two blocks then touch when their gap has closed to within a tenth of a voxel."""

REACH = 1.06
"""Distance of balls that are listed as candidates."""

SLACK = 0.22
"""How far nodes may move before candidates are searched again; less than half of what lies between diameter and reach,
by a share for the compression that all distances undergo meanwhile."""

DAMPING = 0.3
"""Share of critical damping along the line of centers."""

STIFFNESS, STABLE = 0.25, 0.05
"""Stiffness of a contact over the wave modulus, and over the reduced mass of a voxel by the squared step."""

#: What `repel` adds up for each chunk: stored in contacts, lost to damping and friction.
SUMS = 2
CHUNK = 128


@jit
def _balls_of(x: NDArray[Any], corners: NDArray[Any], back: NDArray[Any], dt: float, out: NDArray[Any]) -> None:
    """The eight balls of a voxel, at a time `dt` ago."""
    for a in range(8):
        n = corners[a]
        for c in range(3):
            out[a, c] = x[n, c] - dt * back[n, c]
    _split(out)


@jit
def _split(p: NDArray[Any]) -> None:
    """Weigh the corners by 3/4 and 1/4 along each axis, in place."""
    for c in range(3):
        for bit in (1, 2, 4):
            for a in range(8):
                if not a & bit:
                    low, high = p[a, c], p[a | bit, c]
                    p[a, c], p[a | bit, c] = 0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high


@jit
def place(
    x: NDArray[Any], v: NDArray[Any], dt: float, corners: NDArray[Any], active: NDArray[Any], first: int, last: int,
    balls: NDArray[Any],
) -> None:  # fmt: skip
    """Where the balls of active voxels were a time `dt` ago.

    Parameters
    ----------
    x, v : (nodes, 3) float64
    dt : float
    corners : (voxels, 8) int32
    active : (n,) int32
        Voxels whose balls are placed, of which `first` to `last` are taken.
    first, last : int
    balls : (voxels, 8, 3) float64
        Written.
    """
    for at in range(first, last):
        voxel = active[at]
        _balls_of(x, corners[voxel], v, dt, balls[voxel])


@jit
def search(
    balls: NDArray[Any], carried: NDArray[Any], places: NDArray[Any], origin: NDArray[Any], shape: NDArray[Any],
    pairs: NDArray[Any],
) -> int:  # fmt: skip
    """List the pairs of balls within reach whose voxels are no neighbors.

    Parameters
    ----------
    balls : (voxels, 8, 3) float64
    carried : (voxels,) uint8
        Bits of the corners that have a ball.
    places : (voxels, 3) int32
        Of the voxels in the undeformed body.
    origin : (3,) float64
    shape : (3,) int64
        Cells of a grid that the balls are sorted into; balls beyond count to the cells at its border.
    pairs : (room, 2) int32
        Written, in an order that the positions determine.

    Returns
    -------
    int
        Number of pairs; more than fit were not written.
    """
    nx, ny, nz = shape
    start = np.zeros(nx * ny * nz + 2, np.int32)
    cells = np.empty(len(balls) * 8, np.int32)
    for voxel in range(len(balls)):
        for a in range(8):
            if carried[voxel] >> a & 1:
                i = min(max(int((balls[voxel, a, 0] - origin[0]) / REACH), 0), nx - 1)
                j = min(max(int((balls[voxel, a, 1] - origin[1]) / REACH), 0), ny - 1)
                k = min(max(int((balls[voxel, a, 2] - origin[2]) / REACH), 0), nz - 1)
                cell = i + nx * (j + ny * k)
                cells[8 * voxel + a] = cell
                start[cell + 2] += 1
    for cell in range(1, nx * ny * nz + 2):
        start[cell] += start[cell - 1]
    count = start[nx * ny * nz + 1]
    names = np.empty(count, np.int32)
    sorted_balls = np.empty((count, 3))
    for voxel in range(len(balls)):
        for a in range(8):
            if carried[voxel] >> a & 1:
                to = start[cells[8 * voxel + a] + 1]
                start[cells[8 * voxel + a] + 1] = to + 1
                names[to] = 8 * voxel + a
                for c in range(3):
                    sorted_balls[to, c] = balls[voxel, a, c]
    found = 0
    for k in range(nz):
        for j in range(ny):
            for i in range(nx):
                cell = i + nx * (j + ny * k)
                for row in range(5):
                    # the rest of its own row, then the rows of which each pair is met once
                    dy, dz = (0, 1, -1, 0, 1)[row], (0, 0, 1, 1, 1)[row]
                    if j + dy < 0 or j + dy >= ny or k + dz >= nz:
                        continue
                    there = nx * (j + dy + ny * (k + dz))
                    low = start[there + max(i - 1, 0)]
                    high = start[there + min(i + 1, nx - 1) + 1]
                    for one in range(start[cell], start[cell + 1]):
                        x, y, z = sorted_balls[one, 0], sorted_balls[one, 1], sorted_balls[one, 2]
                        for other in range(one + 1 if row == 0 else low, high):
                            dx, dy_, dz_ = sorted_balls[other, 0] - x, sorted_balls[other, 1] - y, sorted_balls[other, 2] - z
                            if dx * dx + dy_ * dy_ + dz_ * dz_ >= REACH * REACH:
                                continue
                            p, q = names[one] >> 3, names[other] >> 3
                            if (
                                abs(places[p, 0] - places[q, 0]) <= 1
                                and abs(places[p, 1] - places[q, 1]) <= 1
                                and abs(places[p, 2] - places[q, 2]) <= 1
                            ):
                                continue
                            if found < len(pairs):
                                pairs[found, 0], pairs[found, 1] = names[one], names[other]
                            found += 1
    return found


@jit
def list_partners(pairs: NDArray[Any], count: int, starts: NDArray[Any], partners: NDArray[Any]) -> None:
    """The partners of each ball, from pairs of balls.

    Parameters
    ----------
    pairs : (room, 2) int32
    count : int
        Pairs that there are.
    starts : (balls + 1,) int32
        Written: where the partners of each ball begin.
    partners : (2 * count,) int32
        Written.
    """
    starts[:] = 0
    for pair in range(count):
        starts[pairs[pair, 0] + 1] += 1
        starts[pairs[pair, 1] + 1] += 1
    for ball in range(1, len(starts)):
        starts[ball] += starts[ball - 1]
    filled = starts[:-1].copy()
    for pair in range(count):
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
    """Forces of contact on the corners of active voxels.

    Parameters
    ----------
    balls, before, earlier : (voxels, 8, 3) float64
        Now, one step ago and two steps ago.
    active : (n,) int32
        Voxels with balls that have partners, of which the chunks `first` to `last` are taken.
    first, last : int
    starts, partners : int32
        See `list_partners`.
    stiffness, mass : (voxels,) float64
        Of a contact and of a voxel, by its material.
    friction, dt : float
        Coefficient of friction, length of the step.
    lossy : (voxels, 8, 3) float64
        Damping and friction on each ball one step ago; replaced by those of now.
    pushed : (voxels,) uint8
        Written: whether anything touches.
    push : (voxels, 8, 3) float64
        Written where anything touches.
    sums : (chunks, SUMS) float64
        The energy stored in contacts is set; what the forces of one step ago have lost is added, by the mean velocity
        before and after them.
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
                    m = 0.5 * min(mass[p], mass[q])
                    spring = k * DIAMETER * (overlap + 4 * overlap**3)
                    stored += 0.5 * k * DIAMETER**2 * (0.5 * overlap**2 + overlap**4)
                    dx, dy, dz = dx / distance, dy / distance, dz / distance
                    vx = ((x - before[p, a, 0]) - (balls[q, b, 0] - before[q, b, 0])) / dt
                    vy = ((y - before[p, a, 1]) - (balls[q, b, 1] - before[q, b, 1])) / dt
                    vz = ((z - before[p, a, 2]) - (balls[q, b, 2] - before[q, b, 2])) / dt
                    vn = vx * dx + vy * dy + vz * dz
                    vx, vy, vz = vx - vn * dx, vy - vn * dy, vz - vn * dz
                    slip = np.sqrt(vx * vx + vy * vy + vz * vz) + 1e-30
                    damper = min(max(-2 * DAMPING * np.sqrt(k * m) * vn, -spring), spring)
                    drag = min(friction * spring, STABLE * m * slip / dt) / slip
                    fx, fy, fz = fx + spring * dx, fy + spring * dy, fz + spring * dz
                    lx, ly, lz = lx + damper * dx - drag * vx, ly + damper * dy - drag * vy, lz + damper * dz - drag * vz
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
