"""Dart throwing that ends: plain darts while there is room, then darts into the voxels that may still hold a free spot.

Both kernels draw each point uniformly from the free part of the box, given the points already there. Switching from one
to the other, at whatever moment, therefore leaves the distribution that of random sequential addition; the voxels only
save the darts that would hit covered ground (Ebeida et al. 2012, "A simple algorithm for maximal Poisson-disk
sampling in high dimensions"; Quinn et al. 2009 for the name).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit
from sppm_pipeline.numerics.sampling.cell_list import CellList, add_point, is_free, next_uniform

_SPOT = (0.0, 0.0, 0.0)
# Voxels below this fraction of the spacing are within round-off: what is left of them counts as covered.
_FINEST = 1e-9
# Plain darts left in every active voxel of a level before the voxels are split again.
_DARTS_PER_VOXEL = 1.0


@jit
def _throw_one(
    cells: CellList,
    stream: NDArray[np.uint64],
    lower: tuple[float, float, float],
    edge: tuple[float, float, float],
    side: NDArray[np.float64],
    corner: NDArray[np.float64],
    family: int,
    member: int,
) -> bool:
    """Throw one dart into the box at `lower` with edges `edge`; add it if its spot is free."""
    x, y, z = lower
    if edge[0] > 0.0:
        x += edge[0] * next_uniform(stream)
    if edge[1] > 0.0:
        y += edge[1] * next_uniform(stream)
    if edge[2] > 0.0:
        z += edge[2] * next_uniform(stream)
    # The sum may round up to the open end of the box, which on a periodic axis is the other name of its start.
    for axis, value in ((0, x), (1, y), (2, z)):
        if side[axis] > 0.0 and value >= corner[axis] + side[axis]:
            return False
    if not is_free(cells, (x, y, z), _SPOT, family, member):
        return False
    add_point(cells, x, y, z, family, member)
    return True


@jit
def throw_darts(
    cells: CellList,
    stream: NDArray[np.uint64],
    lower: NDArray[np.float64],
    side: NDArray[np.float64],
    wanted: int | np.int64,
    budget: int | np.int64,
    family: int,
    member: int,
) -> int:
    """Throw up to `budget` darts into a box until `wanted` of them were kept; return how many were.

    Parameters
    ----------
    cells : CellList
        Points to keep away from; kept darts are added.
    stream : (1,) uint64
        Random stream; advanced.
    lower, side : (3,)
        Lower corner and edges of the box; a zero edge makes it a plane.
    wanted, budget : int
        Points to add, and darts allowed.
    family, member : int
        Labels of the new points.
    """
    corner = (lower[0], lower[1], lower[2])
    edge = (side[0], side[1], side[2])
    placed = 0
    for _ in range(budget):
        if placed == wanted:
            break
        if _throw_one(cells, stream, corner, edge, side, lower, family, member):
            placed += 1
    return placed


@jit
def _split(
    cells: CellList,
    voxels: NDArray[np.int64],
    count: int,
    lower: NDArray[np.float64],
    edge: NDArray[np.float64],
    parts: NDArray[np.int64],
    family: int,
    member: int,
) -> tuple[NDArray[np.int64], int]:
    """Split each of the first `count` voxels (n, 3) into `parts` along each axis; keep what no point covers.

    `edge` (3,) is the edge of the new voxels. Returns the new voxels in an array that may be longer, and their number.
    """
    kept = np.empty((2 * count + 64, 3), dtype=np.int64)
    n = 0
    half = (edge[0] / 2, edge[1] / 2, edge[2] / 2)
    for row in range(count):
        for c in range(parts[2]):
            k = voxels[row, 2] * parts[2] + c
            for b in range(parts[1]):
                j = voxels[row, 1] * parts[1] + b
                for a in range(parts[0]):
                    i = voxels[row, 0] * parts[0] + a
                    x = lower[0] + i * edge[0] + half[0]
                    y = lower[1] + j * edge[1] + half[1]
                    z = lower[2] + k * edge[2] + half[2]
                    if is_free(cells, (x, y, z), half, family, member):
                        if n == kept.shape[0]:
                            longer = np.empty((2 * n, 3), dtype=np.int64)
                            # A slice assignment would compile Numba's broadcasting errors: two seconds more.
                            for old in range(n):
                                for axis in range(3):
                                    longer[old, axis] = kept[old, axis]
                            kept = longer
                        kept[n, 0] = i
                        kept[n, 1] = j
                        kept[n, 2] = k
                        n += 1
    return kept, n


@jit
def fill_active_voxels(
    cells: CellList,
    stream: NDArray[np.uint64],
    lower: NDArray[np.float64],
    side: NDArray[np.float64],
    wanted: int | np.int64,
    family: int,
    member: int,
) -> int:
    """Add up to `wanted` points to a box; fewer only when no free spot is left. Return how many were added.

    Parameters are those of `throw_darts`, less the budget. Voxels not wholly covered by a single point are kept in a
    list; darts fall uniformly on that list; then every voxel is split in two along each axis and the covered parts are
    dropped, until the count is reached or the list is empty.
    """
    dimension = 0
    for axis in range(3):
        if side[axis] > 0.0:
            dimension += 1
    # A voxel with this edge is wholly covered by a point inside it.
    coarsest = cells.reach / np.sqrt(max(1.0, float(dimension)))
    parts = np.ones(3, dtype=np.int64)
    edge = np.zeros(3)
    finest = np.inf
    for axis in range(3):
        if side[axis] > 0.0:
            parts[axis] = max(1, int(np.ceil(side[axis] / coarsest)))
            edge[axis] = side[axis] / parts[axis]
            finest = min(finest, edge[axis])
    box = np.zeros((1, 3), dtype=np.int64)
    voxels, count = _split(cells, box, box.shape[0], lower, edge, parts, family, member)
    for axis in range(3):
        parts[axis] = 1
        if side[axis] > 0.0:
            parts[axis] = 2
    placed = 0
    while placed < wanted and count > 0 and finest > _FINEST * cells.reach:
        step = (edge[0], edge[1], edge[2])
        for _ in range(int(np.ceil(_DARTS_PER_VOXEL * count))):
            row = min(int(next_uniform(stream) * count), count - 1)
            corner = (
                lower[0] + voxels[row, 0] * edge[0],
                lower[1] + voxels[row, 1] * edge[1],
                lower[2] + voxels[row, 2] * edge[2],
            )
            if _throw_one(cells, stream, corner, step, side, lower, family, member):
                placed += 1
                if placed == wanted:
                    return placed
        for axis in range(3):
            edge[axis] /= 2.0
        finest /= 2.0
        voxels, count = _split(cells, voxels, count, lower, edge, parts, family, member)
    return placed
