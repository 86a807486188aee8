"""Where a part is drilled so that trapped void opens: routes through as little solid as possible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.components import find_components, paint_runs
from sppm_pipeline.services.jit.compiled import jit

AMBIENT = 1
"""Label of all void that reaches the border of the grid."""


class Traps(NamedTuple):
    """Void that opens nowhere, the largest component first.

    Attributes
    ----------
    labels : (nz, ny, nx) int32
        0 in solid, `AMBIENT`, and 2, 3, ... in the traps.
    sizes : (n,) int64
        Voxels of each trap.
    """

    labels: NDArray[np.int32]
    sizes: NDArray[np.int64]


def find_traps(solid: NDArray[np.uint8]) -> Traps:
    """Components of the void (nz, ny, nx) that do not meet the border of the grid, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    number = np.where(closed, 1 + np.cumsum(closed), AMBIENT).astype(np.int32)
    labels = np.zeros(solid.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, number[found.of_run], labels)
    return Traps(labels, found.sizes[closed])


class SmallVoids(NamedTuple):
    """Void that opens nowhere and is small enough to be filled.

    Attributes
    ----------
    sizes : (n,) int64
        Voxels of each, the largest first.
    places : (n, 3) int32
        The first voxel of each, z, y, x.
    runs : (m, 4) int32
        z, y, first x and last x of their runs.
    left : (k,) int64
        Voxels of the closed voids that are larger, the largest first.
    """

    sizes: NDArray[np.int64]
    places: NDArray[np.int32]
    runs: NDArray[np.int32]
    left: NDArray[np.int64]


def find_small_voids(solid: NDArray[np.uint8], largest: float) -> SmallVoids:
    """Components of the void (nz, ny, nx) of up to `largest` voxels that do not meet the border, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    small = closed & (found.sizes <= largest)
    chosen = np.flatnonzero(small[found.of_run])
    z, y = np.divmod(np.searchsorted(found.runs.rows, chosen, "right") - 1, solid.shape[1])
    bounds = found.runs.bounds.reshape(-1, 2)[chosen]
    runs = np.stack([z, y, bounds[:, 0], bounds[:, 1] - 1], 1).astype(np.int32)
    _, first = np.unique(found.of_run[chosen], return_index=True)
    return SmallVoids(found.sizes[small], runs[first, :3], runs, found.sizes[closed & ~small])


class Route(NamedTuple):
    """A way out of a trap.

    Attributes
    ----------
    solid : int
        Voxels of solid on it.
    start, end : (z, y, x)
        A voxel of the trap, and one of the ambient void.
    """

    solid: int
    start: tuple[int, int, int]
    end: tuple[int, int, int]


def way_out(traps: Traps, label: int, lowest: int, highest: int) -> Route | None:
    """The route from a trap to the ambient void of layers lowest <= z <= highest through the least solid.

    Void of other traps costs nothing. Of equal routes the first found counts, which depends on the voxels only. None if
    there is no ambient void in these layers.
    """
    labels = traps.labels
    parent = np.full(labels.size, -1, np.int32)
    end, cost = _search(labels, label, lowest, highest, parent)
    if end < 0:
        return None
    start = end
    while parent[start] != start:
        start = parent[start]
    (z0, y0, x0), (z1, y1, x1) = (np.unravel_index(at, labels.shape) for at in (start, end))
    return Route(cost, (int(z0), int(y0), int(x0)), (int(z1), int(y1), int(x1)))


@jit
def _search(
    labels: NDArray[np.int32], label: int, lowest: int, highest: int, parent: NDArray[np.int32]
) -> tuple[int, int]:
    """Breadth-first search with steps of cost 0 (void) and 1 (solid); the voxel reached and the cost, or -1."""
    nz, ny, nx = labels.shape
    flat = labels.ravel()
    front = np.empty(flat.size, np.int32)
    later = np.empty(flat.size, np.int32)
    n = 0
    for i in range(flat.size):
        if flat[i] == label:
            front[n] = i
            parent[i] = i
            n += 1
    cost = 0
    while n:
        m = 0
        taken = 0
        while taken < n:
            at = front[taken]
            taken += 1
            z, rest = at // (ny * nx), at % (ny * nx)
            y, x = rest // nx, rest % nx
            for side in range(6):
                dz = (1 if side == 1 else -1) if side < 2 else 0
                dy = (1 if side == 3 else -1) if 2 <= side < 4 else 0
                dx = (1 if side == 5 else -1) if side >= 4 else 0
                w, v, u = z + dz, y + dy, x + dx
                if not (0 <= w < nz and 0 <= v < ny and 0 <= u < nx):
                    continue
                other = (w * ny + v) * nx + u
                if parent[other] >= 0:
                    continue
                if flat[other] == AMBIENT:
                    if lowest <= w <= highest:
                        parent[other] = at
                        return other, cost
                    continue
                parent[other] = at
                if flat[other] == 0:
                    later[m] = other
                    m += 1
                else:
                    front[n] = other
                    n += 1
        front, later, n = later, front, m
        cost += 1
    return -1, 0
