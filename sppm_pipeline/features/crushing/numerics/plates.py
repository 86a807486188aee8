"""Motion of the nodes, and the two plates that stop it.

The plates are kinematic: a node that would end beyond a plate ends on it, and the change of its momentum is the force.
Plates push and never pull.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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
