"""The generalized winding number: how often a mesh goes around a point, for meshes with holes a fraction.

It is the solid angle under which the mesh is seen from the point, over that of everything (Jacobson et al. 2013,
"Robust inside-outside segmentation using generalized winding numbers"). Triangles that are far off are summed as one
dipole (Barill et al. 2018, "Fast winding numbers for soups and clouds").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.mesh.box_tree import DEPTH, BoxTree

FAR_RADII = 3.0
"""A node is a dipole for points further off than this many of its radii; numbers are then right to 0.02."""


class Dipoles(NamedTuple):
    """A tree (see `BoxTree`) with what its nodes look like from afar."""

    triangles: F64
    boxes: F64
    starts: I64
    # (nodes, 7): middle by area (3), sum of the area vectors (3), and radius around the middle
    poles: F64


def dipoles(tree: BoxTree) -> Dipoles:
    """Sum up the triangles below each node."""
    return Dipoles(tree.triangles, tree.boxes, tree.starts, _poles(tree.triangles, tree.boxes, tree.starts))


def winding_numbers(tree: Dipoles, points: F64) -> F64:
    """The winding number of points (k, 3); 1 inside a closed mesh, 0 outside, and between them near a hole."""
    return _numbers(tree.triangles, tree.starts, tree.poles, np.ascontiguousarray(points, np.float64), FAR_RADII)


@jit
def _poles(triangles: F64, boxes: F64, starts: I64) -> F64:
    leaves = starts.size - 1
    poles = np.zeros((2 * leaves - 1, 7))
    areas = np.zeros(2 * leaves - 1)
    # from the leaves up: the children of a node come after it
    for node in range(2 * leaves - 2, -1, -1):
        pole = poles[node]
        if node >= leaves - 1:
            leaf = node - leaves + 1
            for i in range(starts[leaf], starts[leaf + 1]):
                t = triangles[i]
                ux, uy, uz = t[1, 0] - t[0, 0], t[1, 1] - t[0, 1], t[1, 2] - t[0, 2]
                vx, vy, vz = t[2, 0] - t[0, 0], t[2, 1] - t[0, 1], t[2, 2] - t[0, 2]
                nx, ny, nz = (uy * vz - uz * vy) / 2, (uz * vx - ux * vz) / 2, (ux * vy - uy * vx) / 2
                area = np.sqrt(nx * nx + ny * ny + nz * nz)
                pole[3] += nx
                pole[4] += ny
                pole[5] += nz
                areas[node] += area
                for a in range(3):
                    pole[a] += area * (t[0, a] + t[1, a] + t[2, a]) / 3
        else:
            for child in (2 * node + 1, 2 * node + 2):
                areas[node] += areas[child]
                for a in range(3):
                    pole[a] += areas[child] * poles[child, a]
                    pole[a + 3] += poles[child, a + 3]
        if areas[node] > 0.0:
            square = 0.0
            for a in range(3):
                pole[a] /= areas[node]
                reach = max(boxes[node, a + 3] - pole[a], pole[a] - boxes[node, a])
                square += reach * reach
            pole[6] = np.sqrt(square)
    return poles


@jit
def _solid_angle(t: F64, x: float, y: float, z: float) -> float:
    """Half the solid angle of a triangle (van Oosterom and Strackee 1983), positive seen from behind."""
    ax, ay, az = t[0, 0] - x, t[0, 1] - y, t[0, 2] - z
    bx, by, bz = t[1, 0] - x, t[1, 1] - y, t[1, 2] - z
    cx, cy, cz = t[2, 0] - x, t[2, 1] - y, t[2, 2] - z
    a = np.sqrt(ax * ax + ay * ay + az * az)
    b = np.sqrt(bx * bx + by * by + bz * bz)
    c = np.sqrt(cx * cx + cy * cy + cz * cz)
    volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    across = a * b * c + (ax * bx + ay * by + az * bz) * c + (bx * cx + by * cy + bz * cz) * a
    across += (cx * ax + cy * ay + cz * az) * b
    return float(np.arctan2(volume, across))


@jit
def winding_at(
    triangles: F64, starts: I64, poles: F64, waiting: I64, x: float, y: float, z: float, far_radii: float
) -> float:
    """Winding number of one point; `waiting` has room for `DEPTH` nodes, and `far_radii` is `FAR_RADII` or less."""
    leaves = starts.size - 1
    near, far = 0.0, 0.0
    waiting[0] = 0
    left = 1
    while left > 0:
        left -= 1
        node = waiting[left]
        pole = poles[node]
        dx, dy, dz = pole[0] - x, pole[1] - y, pole[2] - z
        square = dx * dx + dy * dy + dz * dz
        reach = far_radii * pole[6]
        if square > reach * reach:
            far += (dx * pole[3] + dy * pole[4] + dz * pole[5]) / (square * np.sqrt(square))
        elif node < leaves - 1:
            waiting[left], waiting[left + 1] = 2 * node + 2, 2 * node + 1
            left += 2
        else:
            leaf = node - leaves + 1
            for i in range(starts[leaf], starts[leaf + 1]):
                near += _solid_angle(triangles[i], x, y, z)
    return near / (2 * np.pi) + far / (4 * np.pi)


@jit
def _numbers(triangles: F64, starts: I64, poles: F64, points: F64, far_radii: float) -> F64:
    numbers = np.empty(points.shape[0])
    waiting = np.empty(DEPTH, np.int64)
    for i in range(points.shape[0]):
        numbers[i] = winding_at(triangles, starts, poles, waiting, points[i, 0], points[i, 1], points[i, 2], far_radii)
    return numbers
