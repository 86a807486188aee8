"""Elements, nodes and surface of a body of voxels, ordered so that threads never meet.

Motion of the nodes, and the two plates that stop it.

The plates are kinematic: a node that would end beyond a plate ends on it, and the change of its momentum is the force.
Plates push and never pull.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_crushing.numerics.material import LANES, Material
from sppm_pipeline.numerics import jit

CHUNK = 1024
"""Nodes that are summed together."""

#: Bits of a node's `held`: by a roller along x, along y; or it has left the body.
ROLLS_X, ROLLS_Y, DROPPED = 1, 2, 4

#: What is added up for each chunk: impulse on the lower and upper plate, work of the plates on the body, work lost to
#: damping and to setting the body in motion, kinetic energy, and the largest squared distance that a node has moved
#: within the body.
BOTTOM, TOP, WORK, DAMPED, KINETIC, MOVED = range(6)
SUMS = 6


@jit
def move(
    x: NDArray[Any], v: NDArray[Any], f: NDArray[Any], mass: NDArray[Any], own: NDArray[Any], held: NDArray[Any],
    listed: NDArray[Any], first: int, last: int, step: NDArray[Any], sums: NDArray[Any],
) -> None:  # fmt: skip
    """One step of leapfrog for the chunks `first` to `last` of nodes; forces are reset to 0.

    `x`, `v`, `f` (nodes, 3) are positions, velocities half a step before, forces; `mass` and `own` (nodes,) with and
    without what was added, as damping is proportional to the latter; `listed` (nodes, 3) positions when contacts were
    last searched. `sums` (chunks, SUMS) are added to, but for the kinetic energy and the distance, which are set.
    `step` (10,): length of the step; height of the body before and after it; speed of the upper plate; the damping
    rate times the length of the step; friction of the plates, negative if they stick; height when contacts were last
    searched; widths along x and y of a container, 0 for none; by how much the plate moves faster than in the step
    before, which sets the whole body in motion uniformly.
    """
    dt, height, lower, speed, damping, friction, before, wide_x, wide_y, faster = step
    often, shrink, stretch, kick = 1 / dt, speed / height, lower / before, faster / height
    for chunk in range(first, last):
        bottom, top, work, damped, kinetic, moved = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(chunk * CHUNK, min(chunk * CHUNK + CHUNK, len(x))):
            if held[i] & DROPPED:
                continue
            m = mass[i]
            d = dt / m
            rx, ry, rz = x[i, 0], x[i, 1], x[i, 2]
            vx, vy, vz = v[i, 0], v[i, 1], v[i, 2]
            # damping acts on what is beside uniform compression, and on known velocities: were it to act on new ones,
            # it would take a share of the force that a plate is about to balance
            c = damping * own[i] / m
            cx, cy, cz = c * vx, c * vy, c * (vz + shrink * rz) + kick * rz
            wx, wy, wz = vx + d * f[i, 0] - cx, vy + d * f[i, 1] - cy, vz + d * f[i, 2] - cz
            px, py, pz = wx, wy, wz
            if held[i] & ROLLS_X:
                px = 0.0
            elif wide_x > 0:
                px = min(max(px, -rx * often), (wide_x - rx) * often)
            if held[i] & ROLLS_Y:
                py = 0.0
            elif wide_y > 0:
                py = min(max(py, -ry * often), (wide_y - ry) * often)
            low, high = -rz * often, (lower - rz) * often
            if pz < low or pz > high:
                pz = low if pz < low else high
                push = abs(pz - wz)
                if pz == low:
                    bottom += m * push
                else:
                    top += m * push
                slip = np.sqrt(px * px + py * py)
                if friction < 0:
                    px, py = 0.0, 0.0
                elif slip > 0:
                    # Coulomb: the impulse is at most `friction` times that of the plate, and never reverses the node
                    stays = max(0.0, 1 - friction * push / slip)
                    px, py = stays * px, stays * py
            ax, ay, az = vx + px, vy + py, vz + pz
            work += m * ((px - wx) * ax + (py - wy) * ay + (pz - wz) * az)
            damped += m * (cx * ax + cy * ay + cz * az)
            kinetic += m * (px * px + py * py + pz * pz)
            rx, ry, rz = rx + dt * px, ry + dt * py, rz + dt * pz
            v[i, 0], v[i, 1], v[i, 2] = px, py, pz
            x[i, 0], x[i, 1], x[i, 2] = rx, ry, rz
            f[i, 0], f[i, 1], f[i, 2] = 0.0, 0.0, 0.0
            wx, wy, wz = rx - listed[i, 0], ry - listed[i, 1], rz - listed[i, 2] * stretch
            moved = max(moved, wx * wx + wy * wy + wz * wz)
        sums[chunk, BOTTOM] += bottom
        sums[chunk, TOP] += top
        sums[chunk, WORK] += 0.5 * work
        sums[chunk, DAMPED] += 0.5 * damped
        sums[chunk, KINETIC] = 0.5 * kinetic
        sums[chunk, MOVED] = moved


LAYERS = 2
"""Layers of voxels of a slab; a constant, so that sums do not depend on threads."""


class Body(NamedTuple):
    """A body of voxels with an edge of 1, compressed along z."""

    shape: tuple[int, int, int]  # nx, ny, nz
    voxels: NDArray[np.int32]  # (elements, 3), place x, y, z of each, z slowest
    corners: NDArray[np.int32]  # (elements, 8), nodes; a is on the low side along x, y, z where bit 0, 1, 2 of a is set
    nodes: NDArray[np.int32]  # (nodes, 3), reference positions
    phases: NDArray[np.uint8]  # (elements,), rows of the table of materials
    lanes: NDArray[np.int32]  # (blocks, LANES), which element is where in blocks of one slab and material; -1 for none
    slabs: NDArray[np.int64]  # (slabs + 1,), where the blocks of each slab begin
    surface: NDArray[np.int32]  # (voxels,), elements with an exposed face
    carried: NDArray[np.uint8]  # (voxels,), bits of those of their corners that lie at an exposed face

    def blocked(self, values: NDArray[Any], empty: Any) -> NDArray[Any]:
        """Values of elements, in blocks."""
        return np.ascontiguousarray(
            np.where((self.lanes >= 0).reshape(self.lanes.shape + (1,) * (values.ndim - 1)), values[self.lanes], empty)
        )


def body_of(image: NDArray[np.uint8], *, confined: bool = False) -> Body:
    """The body of an image (nz, ny, nx) of phases from 1 on, 0 for void; `ValueError` if all is void.

    With `confined` walls close the sides, so that nothing is exposed there.
    """
    nz, ny, nx = image.shape
    z, y, x = (index.astype(np.int32) for index in np.nonzero(image))
    if not len(x):
        raise ValueError("there is no solid")
    phases = image[z, y, x] - np.uint8(1)
    ends = np.array([[1 - (a >> c & 1) for a in range(8)] for c in range(3)], np.int64)
    grid = ((z[:, None] + ends[2]) * (ny + 1) + y[:, None] + ends[1]) * (nx + 1) + x[:, None] + ends[0]
    used = np.zeros((nz + 1) * (ny + 1) * (nx + 1), bool)
    used[grid] = True
    number = np.cumsum(used, dtype=np.int32) - 1
    places = np.flatnonzero(used)
    nodes = np.stack([places % (nx + 1), places // (nx + 1) % (ny + 1), places // ((nx + 1) * (ny + 1))], axis=1)
    lanes, slabs = _blocks(z // LAYERS, phases, -(-nz // LAYERS))
    voxels = np.stack([x, y, z], axis=1)
    surface, carried = surface_of((nx, ny, nz), voxels, confined)
    return Body(
        (nx, ny, nz), voxels, number[grid], nodes.astype(np.int32), phases, lanes, slabs, surface, carried,
    )  # fmt: skip


def surface_of(
    shape: tuple[int, int, int], voxels: NDArray[np.int32], confined: bool
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Which of the voxels (n, 3) have an exposed face, and bits of those of their corners that lie at one."""
    x, y, z = voxels.T
    solid = np.zeros(shape[::-1], bool)
    solid[z, y, x] = True
    exposed = _exposed(solid, confined)[:, z, y, x]
    carried = np.zeros(len(x), np.uint8)
    for a in range(8):
        at = exposed[0 + (a & 1)] | exposed[2 + (a >> 1 & 1)] | exposed[4 + (a >> 2 & 1)]
        carried |= at.astype(np.uint8) << np.uint8(a)
    surface = np.flatnonzero(carried).astype(np.int32)
    return surface, carried[surface]


def _blocks(
    slab: NDArray[np.int32], phases: NDArray[np.uint8], slabs: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Elements of each slab and phase in blocks of LANES."""
    key = slab.astype(np.int64) * 256 + phases
    order = np.argsort(key, kind="stable")
    groups, begin, count = np.unique(key[order], return_index=True, return_counts=True)
    blocks = -(-count // LANES)
    first = np.concatenate([[0], np.cumsum(blocks)])
    lanes = np.full((first[-1], LANES), -1, np.int32)
    for at, start, many in zip(first[:-1], begin, count, strict=True):
        lanes.reshape(-1)[at * LANES : at * LANES + many] = order[start : start + many]
    return lanes, np.concatenate([[0], np.cumsum(np.bincount(groups // 256, blocks, slabs))]).astype(np.int64)


def _exposed(solid: NDArray[np.bool_], confined: bool) -> NDArray[np.bool_]:
    """Which faces of solid voxels are at void: high and low along x, y, z."""
    padded = np.pad(solid, ((1, 1), (1, 1), (1, 1)))
    if confined:
        padded = np.pad(np.pad(solid, ((0, 0), (1, 1), (1, 1)), mode="edge"), ((1, 1), (0, 0), (0, 0)))
    inner = (slice(1, -1),) * 3
    return np.stack([solid & ~np.roll(padded, shift, axis)[inner] for axis in (2, 1, 0) for shift in (-1, 1)])


def wave_speed(materials: tuple[Material, ...]) -> float:
    """Speed of pressure waves, of all phases, over that of waves in a bar of the first."""
    return float((materials[0].wave_modulus / materials[0].young) ** 0.5)
