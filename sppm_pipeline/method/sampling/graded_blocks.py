"""Density, spacing and metrics that vary over a lattice of blocks, and darts that keep them.

They are given at nodes, `NODES` to an edge of a block. In between the spacing, the power -1/3 of the density, is
linear: where sizes change at a constant rate the density is exact, and does not rise above itself as the chord of so
bent a curve would.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.sampling.cell_list import CellList, bucket_of, search_range, wrapped
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.services.jit.compiled import jit

NODES = 4
"""Nodes along an edge of a block."""


def density_means(nodes: F64) -> F64:
    """Means over the blocks, (nx, ny, nz), of a density at nodes, whose power -1/3 is linear in between."""
    return _density_means(np.ascontiguousarray(nodes, np.float64) ** (-1 / 3))


@jit
def _density_means(spacings: F64) -> F64:
    """Means of the power -3 of trilinear functions: three points of Gauss along each axis between nodes."""
    nx, ny, nz = spacings.shape[0] // NODES, spacings.shape[1] // NODES, spacings.shape[2] // NODES
    out = np.zeros((nx, ny, nz))
    off = 0.5 * np.sqrt(0.6)
    places, weights = np.array([0.5 - off, 0.5, 0.5 + off]), np.array([5.0, 8.0, 5.0]) / 18
    plane, row = np.empty((2, 2)), np.empty(2)
    for i in range(nx * NODES):
        for j in range(ny * NODES):
            for k in range(nz * NODES):
                total = 0.0
                for a in range(3):
                    for m in range(2):
                        for n in range(2):
                            low, high = spacings[i, j + m, k + n], spacings[i + 1, j + m, k + n]
                            plane[m, n] = low + places[a] * (high - low)
                    for b in range(3):
                        for n in range(2):
                            row[n] = plane[0, n] + places[b] * (plane[1, n] - plane[0, n])
                        for c in range(3):
                            value = row[0] + places[c] * (row[1] - row[0])
                            total += weights[a] * weights[b] * weights[c] / (value * value * value)
                out[i // NODES, j // NODES, k // NODES] += total / NODES**3
    return out


def at_nodes(nodes: F64, points: F64) -> F64:
    """Values (n, m) at points (n, 3) of the lattice, linear between nodes (..., m) and constant beyond them."""
    place = np.clip(points * NODES, 0.0, np.array(nodes.shape[:3]) - 1.0)
    low = np.minimum(place.astype(np.int64), np.array(nodes.shape[:3]) - 2)
    part, total = place - low, np.zeros((len(points), nodes.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = np.abs(1.0 - np.array(corner) - part).prod(axis=1)
        total += weight[:, None] * nodes[tuple((low + corner).T)]
    return total


@jit
def value_at(nodes: F64, x: float, y: float, z: float) -> float:
    """A value at a place of the lattice, linear between nodes and constant beyond them."""
    px = min(max(x * NODES, 0.0), nodes.shape[0] - 1.0)
    py = min(max(y * NODES, 0.0), nodes.shape[1] - 1.0)
    pz = min(max(z * NODES, 0.0), nodes.shape[2] - 1.0)
    i = min(int(px), nodes.shape[0] - 2)
    j = min(int(py), nodes.shape[1] - 2)
    k = min(int(pz), nodes.shape[2] - 2)
    total = 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                weight = abs(1.0 - a - px + i) * abs(1.0 - b - py + j) * abs(1.0 - c - pz + k)
                total += weight * nodes[i + a, j + b, k + c]
    return total


@jit
def metric_at(nodes: F64, x: float, y: float, z: float, out: F64) -> None:
    """Set the six entries of a metric to those at a place of the lattice."""
    for entry in range(6):
        out[entry] = value_at(nodes[..., entry], x, y, z)


@jit
def is_free(cells: CellList, spacings: F64, metrics: F64 | None, place: F64, own: float, metric: F64) -> bool:
    """True if all points are at least the mean of their spacing and `own` away; plainly, if there are no metrics."""
    nz, ny, nx = cells.first.shape
    wx, wy, wz = cells.period[0] == 1.0, cells.period[1] == 1.0, cells.period[2] == 1.0
    repeats = wx or wy or wz
    i, j, k = bucket_of(cells, place[0], place[1], place[2])
    i0, ni = search_range(i, nx, wx)
    j0, nj = search_range(j, ny, wy)
    k0, nk = search_range(k, nz, wz)
    for dk in range(nk):
        kk = wrapped(k0 + dk, nz)
        for dj in range(nj):
            jj = wrapped(j0 + dj, ny)
            for di in range(ni):
                row = cells.first[kk, jj, wrapped(i0 + di, nx)]
                while row >= 0:
                    dx, dy, dz = (
                        cells.points[row, 0] - place[0],
                        cells.points[row, 1] - place[1],
                        cells.points[row, 2] - place[2],
                    )
                    if repeats:
                        dx -= np.floor(dx + 0.5) if wx else 0.0
                        dy -= np.floor(dy + 0.5) if wy else 0.0
                        dz -= np.floor(dz + 0.5) if wz else 0.0
                    apart = 0.5 * (spacings[row] + own)
                    squared = dx * dx + dy * dy + dz * dz
                    if metrics is not None:
                        m = metrics[row]
                        squared = 0.5 * (
                            (m[0] + metric[0]) * dx * dx + (m[1] + metric[1]) * dy * dy + (m[2] + metric[2]) * dz * dz
                        ) + ((m[3] + metric[3]) * dx * dy + (m[4] + metric[4]) * dx * dz + (m[5] + metric[5]) * dy * dz)
                    if squared < apart * apart:
                        return False
                    row = cells.following[row]
    return True
