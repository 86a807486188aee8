"""Dart throwing that ends: plain darts while there is room, then darts into the voxels that may still hold a free spot.

Both kernels draw each point uniformly from the free part of the box, given the points already there. Switching from one
to the other, at whatever moment, therefore leaves the distribution that of random sequential addition; the voxels only
save the darts that would hit covered ground (Ebeida et al. 2012, "A simple algorithm for maximal Poisson-disk
sampling in high dimensions"; Quinn et al. 2009 for the name).
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.method.sampling.cell_list import CellList, add_point, axis_gap, is_free, next_uniform
from sppm_pipeline.method.sampling.voxels import Voxels, all_voxels, halved
from sppm_pipeline.services.arrays import F64, U64
from sppm_pipeline.services.jit.compiled import jit

# Voxels below this fraction of the spacing are within round-off: what is left of them counts as covered.
_FINEST = 1e-9
# Plain darts left in every active voxel of a level before the voxels are split again.
_DARTS_PER_VOXEL = 1.0


@jit
def _dart(stream: U64, x: float, y: float, z: float, edge: tuple[float, float, float]) -> tuple[float, float, float]:
    """A spot in the box with the low corner (x, y, z) and the edges `edge`."""
    if edge[0] > 0.0:
        x += edge[0] * next_uniform(stream)
    if edge[1] > 0.0:
        y += edge[1] * next_uniform(stream)
    if edge[2] > 0.0:
        z += edge[2] * next_uniform(stream)
    return x, y, z


@jit
def _add_dart(cells: CellList, x: float, y: float, z: float, side: F64, corner: F64, family: int, member: int) -> bool:
    """Add a point if its spot is free."""
    # The sum may round up to the open end of the box, which on a periodic axis is the other name of its start.
    for axis, value in ((0, x), (1, y), (2, z)):
        if side[axis] > 0.0 and value >= corner[axis] + side[axis]:
            return False
    if not is_free(cells, (x, y, z), family, member):
        return False
    add_point(cells, x, y, z, family, member)
    return True


@jit
def throw_darts(
    cells: CellList,
    stream: U64,
    lower: F64,
    side: F64,
    wanted: int | np.int64,
    budget: int | np.int64,
    family: int,
    member: int,
) -> int:
    """Throw up to `budget` darts into a box until `wanted` of them were kept; return how many were.

    Kept darts are added to `cells` with the labels `family` and `member`; `stream` (1,) is advanced. A zero edge in
    `side` (3,) makes the box a plane.
    """
    edge = (side[0], side[1], side[2])
    placed = 0
    for _ in range(budget):
        if placed == wanted:
            break
        x, y, z = _dart(stream, lower[0], lower[1], lower[2], edge)
        if _add_dart(cells, x, y, z, side, lower, family, member):
            placed += 1
    return placed


@jit
def fill_active_voxels(
    cells: CellList, stream: U64, lower: F64, side: F64, wanted: int | np.int64, family: int, member: int
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
    # the diagonal of a voxel with this edge is the spacing: a point inside it covers all of it
    coarsest = cells.reach / np.sqrt(max(1.0, float(dimension)))
    parts = np.ones(3, dtype=np.int64)
    edge = np.zeros(3)
    finest = np.inf
    for axis in range(3):
        if side[axis] > 0.0:
            parts[axis] = max(1, int(np.ceil(side[axis] / coarsest)))
            edge[axis] = side[axis] / parts[axis]
            finest = min(finest, edge[axis])
    roots = (parts[0], parts[1], parts[2])
    wide = (edge[0], edge[1], edge[2])
    voxels = all_voxels(cells, lower, wide, roots, family, member)
    for axis in range(3):
        parts[axis] = 1
        if side[axis] > 0.0:
            parts[axis] = 2
    placed = 0
    while placed < wanted and voxels.number > 0 and finest > _FINEST * cells.reach:
        step = (edge[0], edge[1], edge[2])
        # points of this level: only they can cover what was free before it
        since = cells.used[0]
        for _ in range(int(np.ceil(_DARTS_PER_VOXEL * voxels.number))):
            row = min(int(next_uniform(stream) * voxels.number), voxels.number - 1)
            x, y, z = _dart(
                stream,
                lower[0] + voxels.places[row, 0] * edge[0],
                lower[1] + voxels.places[row, 1] * edge[1],
                lower[2] + voxels.places[row, 2] * edge[2],
                step,
            )
            # most darts fail at a point that is known to reach into the voxel
            if _is_free_in(cells, voxels, row, x, y, z) and _add_dart(cells, x, y, z, side, lower, family, member):
                placed += 1
                if placed == wanted:
                    return placed
        for axis in range(3):
            edge[axis] /= 2.0
        finest /= 2.0
        voxels = halved(cells, voxels, lower, edge, parts, roots, wide, since)
    return placed


@jit
def _is_free_in(cells: CellList, voxels: Voxels, row: int, x: float, y: float, z: float) -> bool:
    """True if none of the points of a voxel covers a spot in it."""
    points, period, reach2 = cells.points, cells.period, cells.reach * cells.reach
    for s in range(voxels.first[row], voxels.first[row + 1]):
        p = voxels.points[s]
        dx = axis_gap(points[p, 0], x, period[0])
        dy = axis_gap(points[p, 1], y, period[1])
        dz = axis_gap(points[p, 2], z, period[2])
        if dx * dx + dy * dy + dz * dz < reach2:
            return False
    return True
