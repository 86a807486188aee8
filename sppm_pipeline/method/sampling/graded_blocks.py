"""Dart throwing on a lattice of blocks where density and spacing vary from place to place.

Two pores at p and q keep the mean of the spacings there, ``(l(p) + l(q)) / 2``. A dart is uniform in its block and kept
with a probability proportional to the density at its place; blocks, colors and random streams are those of
`blocks.throw_blocks`. The density is given at nodes, `NODES` to an edge of a block. In between the spacing, its power
-1/3, is linear: where sizes change at a constant rate the density is exact, and does not rise above itself as the chord
of so bent a curve would.

Where pores are stretched, their distance is measured in the mean of the metrics at p and q, and the spacing is that of
as many pores in the metric: the same as if round pores had been thrown and then been stretched.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.blocks import ATTEMPTS, block_colors, list_neighbors
from sppm_pipeline.method.sampling.cell_list import (
    CellList,
    add_point,
    bucket_of,
    empty_cell_list,
    next_uniform,
    search_range,
)
from sppm_pipeline.method.tiling.lattice import INTERIOR, hash_places
from sppm_pipeline.services.jit.compiled import jit
from sppm_pipeline.services.metric import determinants, semi_axes
from sppm_pipeline.services.threads import ordered_map

NODES = 4
"""Nodes along an edge of a block."""

DARTS = 400
"""Darts for each pore that is wanted before a block is thrown anew: a choice, as at 60 % of the packing limit some 30
are needed."""


def graded_quotas(mask: NDArray[np.bool_], mean: float, density: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers of pores of the blocks, (nx, ny, nz): the integral of the density, the rest carried on in order z, y, x.

    Parameters
    ----------
    mask : (nx, ny, nz) bool
    mean : float
        Pores of a block where the density is 1.
    density : (NODES nx + 1, NODES ny + 1, NODES nz + 1) float64
        At the nodes.
    """
    nx, ny, nz = mask.shape
    wanted = mean * density_means(density)
    steps = np.floor(np.concatenate([[0.0], np.cumsum(np.where(mask, wanted, 0.0).transpose(2, 1, 0).ravel())]) + 0.5)
    return np.diff(steps).astype(np.int64).reshape(nz, ny, nx).transpose(2, 1, 0)


def density_means(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over the blocks, (nx, ny, nz), of a density at nodes, whose power -1/3 is linear in between."""
    return _density_means(np.ascontiguousarray(nodes, np.float64) ** (-1 / 3))


@jit
def _density_means(spacings: NDArray[np.float64]) -> NDArray[np.float64]:
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


def at_nodes(nodes: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (n, m) at points (n, 3) of the lattice, linear between nodes (..., m) and constant beyond them."""
    place = np.clip(points * NODES, 0.0, np.array(nodes.shape[:3]) - 1.0)
    low = np.minimum(place.astype(np.int64), np.array(nodes.shape[:3]) - 2)
    part, total = place - low, np.zeros((len(points), nodes.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = np.abs(1.0 - np.array(corner) - part).prod(axis=1)
        total += weight[:, None] * nodes[tuple((low + corner).T)]
    return total


def throw_graded_blocks(
    seed: int,
    quotas: NDArray[np.int64],
    spacing: float,
    density: NDArray[np.float64],
    *,
    metric: NDArray[np.float64] | None = None,
    before: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None,
    threads: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Throw the pores of a lattice of blocks that does not repeat.

    Parameters
    ----------
    seed : int
        Taken modulo 2^64.
    quotas : (nx, ny, nz) int64
        Pores of each block.
    spacing : float
        Smallest distance of two pores where the density is 1, block edges; elsewhere it goes with density^(-1/3).
    density : (NODES nx + 1, ...) float64
        At the nodes; positive.
    metric : (NODES nx + 1, ..., 6) float64, optional
        At the nodes, see `numerics.metric`.
    before : ((k, 3) float64, (blocks + 1,) int64), optional
        Pores that are there already, in the form of the result.
    threads : int
        Number of threads; the result does not depend on it.

    Returns
    -------
    centers : (n, 3) float64
        Relative to the low corner of the block, in block edges; blocks in C order of (x, y, z).
    first : (blocks + 1,) int64
        Where the pores of each block begin.

    Raises
    ------
    DesignError
        If the spacing is longer than a block somewhere, or a block holds fewer pores than its quota.
    """
    quotas = np.ascontiguousarray(quotas, np.int64)
    packing, metrics = density, np.zeros((1, 1, 1, 6))
    widest, closest = (spacing * float(d) ** (-1 / 3) for d in (density.min(), density.max()))
    if metric is not None:
        packing, metrics = density / np.sqrt(determinants(metric)), metric
        widest = spacing * float((packing.ravel() ** (-1 / 3) * semi_axes(metric.reshape(-1, 6))[:, 0]).max())
    if not 0 < widest <= 1:
        raise DesignError(
            f"the pore spacing reaches {widest:.4g} cell sizes where pores are fewest; at most 1 is possible",
            hint="give a larger cell: pores of a block look at the neighboring blocks only",
        )
    first = np.concatenate([[0], np.cumsum(quotas.ravel())])
    centers = np.empty((int(first[-1]), 3))
    old = before if before is not None else (np.zeros((0, 3)), np.zeros(quotas.size + 1, np.int64))
    streams = hash_places(seed, INTERIOR, *np.ogrid[tuple(slice(n) for n in quotas.shape)]).ravel()
    colors = block_colors(quotas.shape).ravel()
    most = int((quotas.ravel() + np.diff(old[1])).max(initial=0))
    # no packing of balls is denser than pi / sqrt(18); those around a block lie within the widest spacing
    rows = int(min(27 * most, math.sqrt(2.0) * (1 + 3 * widest) ** 3 / closest**3 + 27)) + most
    missing = np.zeros(quotas.size, np.int64)
    of_darts = np.ascontiguousarray(density, np.float64) ** (-1 / 3)
    of_spacings = of_darts if packing is density else np.ascontiguousarray(packing, np.float64) ** (-1 / 3)
    of_metrics = np.ascontiguousarray(metrics, np.float64)

    def throw(blocks: NDArray[np.int64]) -> None:
        cells = empty_cell_list(rows, widest, np.zeros(3), np.ones(3), (False, False, False))
        lattice = (blocks, np.array(quotas.shape), streams, first, centers, *old)
        _throw_in_turn(cells, *lattice, of_darts, of_spacings, of_metrics, spacing, missing)

    for color in range(int(colors.max()) + 1):
        blocks = np.flatnonzero((colors == color) & (quotas.ravel() > 0))
        if len(blocks):
            parts = np.array_split(blocks, min(len(blocks), 4 * threads)) if threads > 1 else [blocks]
            for _ in ordered_map(throw, parts, threads):
                pass
    if missing.any():
        worst = int(missing.argmax())
        place = tuple(int(i) for i in np.unravel_index(worst, quotas.shape))
        wanted = int(quotas.ravel()[worst])
        raise DesignError(
            f"only {wanted - missing[worst]} of {wanted} pores fit into the block {place} with the spacing there; "
            f"{np.count_nonzero(missing)} of {np.count_nonzero(quotas)} blocks are too full",
            hint="ask for a smaller `share` or `spacing` in the recipe",
        )
    return centers, first


@jit
def _at(nodes: NDArray[np.float64], x: float, y: float, z: float) -> float:
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
def is_free(
    cells: CellList,
    spacings: NDArray[np.float64],
    metrics: NDArray[np.float64],
    place: NDArray[np.float64],
    own: float,
    metric: NDArray[np.float64],
) -> bool:
    """Whether all points are at least the mean of their spacing and `own` away; plainly, if there are no metrics."""
    nz, ny, nx = cells.first.shape
    i, j, k = bucket_of(cells, place[0], place[1], place[2])
    i0, ni = search_range(i, nx, False)
    j0, nj = search_range(j, ny, False)
    k0, nk = search_range(k, nz, False)
    for kk in range(k0, k0 + nk):
        for jj in range(j0, j0 + nj):
            for ii in range(i0, i0 + ni):
                row = cells.first[kk, jj, ii]
                while row >= 0:
                    dx, dy, dz = (
                        cells.points[row, 0] - place[0],
                        cells.points[row, 1] - place[1],
                        cells.points[row, 2] - place[2],
                    )
                    apart = 0.5 * (spacings[row] + own)
                    squared = dx * dx + dy * dy + dz * dz
                    if len(metrics) > 0:
                        m = metrics[row]
                        squared = 0.5 * (
                            (m[0] + metric[0]) * dx * dx + (m[1] + metric[1]) * dy * dy + (m[2] + metric[2]) * dz * dz
                        ) + ((m[3] + metric[3]) * dx * dy + (m[4] + metric[4]) * dx * dz + (m[5] + metric[5]) * dy * dz)
                    if squared < apart * apart:
                        return False
                    row = cells.following[row]
    return True


@jit
def _throw_in_turn(
    cells: CellList,
    blocks: NDArray[np.int64],
    shape: NDArray[np.int64],
    streams: NDArray[np.uint64],
    first: NDArray[np.int64],
    centers: NDArray[np.float64],
    old_centers: NDArray[np.float64],
    old_first: NDArray[np.int64],
    nodes: NDArray[np.float64],
    packing: NDArray[np.float64],
    metric_nodes: NDArray[np.float64],
    spacing: float,
    missing: NDArray[np.int64],
) -> None:
    """Throw the pores of blocks that are not neighbors; what can't be placed is noted in `missing`.

    Both `nodes` and `packing` are powers -1/3 of densities: darts follow the one, spacings the other. One node of
    metrics alone stands for plain distances.
    """
    rows = cells.points.shape[0]
    spacings = np.empty(rows)
    stretched = metric_nodes.shape[0] > 1
    metrics = np.empty((rows if stretched else 0, 6))
    own_metric, place = np.zeros(6), np.zeros(3)
    wraps = np.zeros(3, np.bool_)
    for block in blocks:
        stream = streams[block : block + 1].copy()
        wanted = first[block + 1] - first[block]
        x0, y0, z0 = block // (shape[1] * shape[2]), block // shape[2] % shape[1], block % shape[2]
        least = np.inf
        for i in range(NODES + 1):
            for j in range(NODES + 1):
                for k in range(NODES + 1):
                    least = min(least, nodes[x0 * NODES + i, y0 * NODES + j, z0 * NODES + k])
        for _ in range(ATTEMPTS):
            list_neighbors(cells, block, shape, False, wraps, streams, first, centers, old_centers, old_first)
            start = cells.used[0]
            for row in range(start):
                p = cells.points[row]
                spacings[row] = spacing * _at(packing, x0 + p[0], y0 + p[1], z0 + p[2])
                if stretched:
                    for entry in range(6):
                        metrics[row, entry] = _at(metric_nodes[..., entry], x0 + p[0], y0 + p[1], z0 + p[2])
            placed, darts = 0, 0
            while placed < wanted and darts < DARTS * wanted + 1000:
                x, y, z = next_uniform(stream), next_uniform(stream), next_uniform(stream)
                here = _at(nodes, x0 + x, y0 + y, z0 + z)
                if next_uniform(stream) * here * here * here > least * least * least:
                    continue
                darts += 1
                if stretched:
                    here = _at(packing, x0 + x, y0 + y, z0 + z)
                    for entry in range(6):
                        own_metric[entry] = _at(metric_nodes[..., entry], x0 + x, y0 + y, z0 + z)
                own = spacing * here
                place[0], place[1], place[2] = x, y, z
                if is_free(cells, spacings, metrics, place, own, own_metric):
                    row = cells.used[0]
                    spacings[row] = own
                    if stretched:
                        metrics[row] = own_metric
                    add_point(cells, x, y, z, 0, 0)
                    placed += 1
            missing[block] = wanted - placed
            if placed == wanted:
                break
        for row in range(placed):
            for axis in range(3):
                centers[first[block] + row, axis] = cells.points[start + row, axis]
        streams[block] = 0
