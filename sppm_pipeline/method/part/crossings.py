"""Points where grid edges pierce the triangles of a part: its surface to the last bit, sharp edges included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F64, I32, I64, Bools
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.jit.compiled import jit

_AT_NODE = 1e-6
"""A crossing so near to a node, in grid edges, belongs to both edges that meet there."""


class Crossings(NamedTuple):
    """Crossings of grid edges with triangles, sorted by edge, and by triangle on the same edge."""

    edge: I64  # ``3 * node + axis``; node (i, j, k), where the edge begins, is ``(k * ny + j) * nx + i``
    share: F64  # place on the edge, from 0 at its node to 1 at the next
    triangle: I32
    normals: F64  # of all triangles, (m, 3); zero without area


NO_CROSSINGS = Crossings(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int32), np.empty((0, 3)))


def unit_normals(triangles: F64) -> F64:
    """Unit normals of triangles (m, 3, 3), zero for those without area."""
    normals: F64 = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    np.divide(normals, length, out=normals, where=length > 0)
    return normals


def grid_crossings(triangles: F64, normals: F64, grid: Grid, start: int, stop: int) -> Crossings:
    """Crossings of all grid edges that begin in the planes start <= k < stop with triangles (m, 3, 3).

    Those of consecutive ranges of planes, one after the other, are those of the whole grid.
    """
    origin, spacing = np.array(grid.origin), np.array(grid.spacing)
    a, b, c = (triangles[:, corner, 2] for corner in range(3))  # much faster than along an axis of three
    low, high = origin[2] + (start - 1) * spacing[2], origin[2] + stop * spacing[2]
    reached = (np.maximum(np.maximum(a, b), c) >= low) & (np.minimum(np.minimum(a, b), c) <= high)
    near = np.flatnonzero(reached).astype(np.int32)
    shape = np.array(grid.shape)
    # a guess: the kernel counts what it has no room for, and is then called again
    room = 1024 + 2 * len(near)
    while True:
        found = np.empty(room, np.int64), np.empty(room), np.empty(room, np.int32)
        n = _cross(triangles, near, origin, spacing, shape, start, stop, *found)
        if n <= room:
            break
        room = n
    found = found[0][:n], found[1][:n], found[2][:n]
    # stable: triangles were taken in ascending order
    order = np.argsort(found[0], kind="stable")
    return Crossings(found[0][order], found[1][order], found[2][order], normals)


@jit
def _cross(
    triangles: F64,
    near: I32,
    origin: F64,
    spacing: F64,
    shape: I64,
    start: int,
    stop: int,
    edges: I64,
    shares: F64,
    owners: I32,
) -> int:
    """Number of crossings; as many as there is room for are written."""
    n = 0
    node, low, high = np.empty(3, np.int64), np.empty(3, np.int64), np.empty(3, np.int64)
    first, beyond = np.zeros(3, np.int64), shape.copy()
    first[2], beyond[2] = start, stop
    p = np.empty((3, 3))
    for f in near:
        for c in range(3):
            for a in range(3):
                p[c, a] = (triangles[f, c, a] - origin[a]) / spacing[a]
        for a in range(3):
            low[a] = max(first[a], np.int64(np.ceil(min(p[0, a], p[1, a], p[2, a]) - _AT_NODE)))
            high[a] = min(beyond[a] - 1, np.int64(np.floor(max(p[0, a], p[1, a], p[2, a]) + _AT_NODE)))
        for axis in range(3):
            b, c = (axis + 1) % 3, (axis + 2) % 3
            ub, uc, vb, vc = p[1, b] - p[0, b], p[1, c] - p[0, c], p[2, b] - p[0, b], p[2, c] - p[0, c]
            # twice the area of the triangle's shadow on the plane across the axis
            area = ub * vc - uc * vb
            # seen edge-on along this axis: the other two axes find it
            if area == 0.0:
                continue
            for nc in range(low[c], high[c] + 1):
                for nb in range(low[b], high[b] + 1):
                    qb, qc = nb - p[0, b], nc - p[0, c]
                    s, r = (qb * vc - qc * vb) / area, (ub * qc - uc * qb) / area
                    if s < -_AT_NODE or r < -_AT_NODE or s + r > 1.0 + _AT_NODE:
                        continue
                    at = p[0, axis] + s * (p[1, axis] - p[0, axis]) + r * (p[2, axis] - p[0, axis])
                    for side in range(2):  # the edge it lies on, and the one beyond a node that it lies at
                        i = np.int64(np.floor(at - _AT_NODE if side == 0 else at + _AT_NODE))
                        if side == 1 and i == np.int64(np.floor(at - _AT_NODE)):
                            continue
                        if i < first[axis] or i >= min(beyond[axis], shape[axis] - 1):
                            continue
                        if n < edges.size:
                            node[axis], node[b], node[c] = i, nb, nc
                            edges[n] = 3 * ((node[2] * shape[1] + node[1]) * shape[0] + node[0]) + axis
                            shares[n] = min(max(at - i, 0.0), 1.0)
                            owners[n] = f
                        n += 1
    return n


def on_surface(crossings: Crossings, grid: Grid, start: int, stop: int) -> Bools:
    """Which nodes of the planes start <= k < stop lie on a triangle, up to rounding; (stop - start, ny, nx)."""
    nx, ny, _ = grid.shape
    found = np.zeros((stop - start, ny, nx), np.bool_)
    flat = found.reshape(-1)
    step = np.array([1, nx, nx * ny])[crossings.edge % 3]
    node = crossings.edge // 3 - start * nx * ny
    flat[node[crossings.share < _AT_NODE]] = True
    beyond = (node + step)[crossings.share > 1 - _AT_NODE]
    flat[beyond[beyond < flat.size]] = True
    return found
