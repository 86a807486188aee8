"""Void that opens nowhere, for drains and fills, and the longest way out of void that is open."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.connectivity.components import find_components, paint_runs
from sppm_pipeline.services.jit.compiled import jit

AMBIENT = 1
"""Label of all void that reaches the border of the grid."""


class Traps(NamedTuple):
    """Void that opens nowhere, the largest component first."""

    labels: NDArray[np.int32]  # (nz, ny, nx): 0 in solid, `AMBIENT`, and 2, 3, ... in the traps
    sizes: NDArray[np.int64]  # (n,), voxels of each trap


def find_traps(solid: NDArray[np.uint8]) -> Traps:
    """Components of the void (nz, ny, nx) that do not meet the border of the grid, across faces."""
    found = find_components(solid, (False, False, False), 6, zeros=True)
    closed = ~found.faces.any(1)
    number = np.where(closed, 1 + np.cumsum(closed), AMBIENT).astype(np.int32)
    labels = np.zeros(solid.shape, np.int32)
    paint_runs(found.runs.rows, found.runs.bounds, number[found.of_run], labels)
    return Traps(labels, found.sizes[closed])


class SmallVoids(NamedTuple):
    """Void that opens nowhere and is small enough to be filled."""

    sizes: NDArray[np.int64]  # (n,), voxels of each, the largest first
    places: NDArray[np.int32]  # (n, 3), the first voxel of each, z, y, x
    runs: NDArray[np.int32]  # (m, 4), z, y, first x and last x of their runs
    left: NDArray[np.int64]  # (k,), voxels of the closed voids that are larger, the largest first


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


class Depth:
    """The longest way for powder out of what is open; take in layers by `add`, then ask `longest`.

    A block, of `block` voxels along its edge, is open if any of its voxels is, which keeps passages that are thinner
    than a block. Ways go along the axes, from block to block across faces, and end where the image does, on all six
    sides. `shape` is (nx, ny).
    """

    def __init__(self, shape: tuple[int, int], block: int) -> None:
        self._x, self._y = (np.arange(0, n, block) for n in shape)
        self._block = block
        self._sheet = np.zeros((len(self._y), len(self._x)), np.uint8)
        self._taken = 0
        self._done: list[NDArray[np.uint8]] = []

    def add(self, layer: NDArray[np.uint8]) -> None:
        """Take in the next layer, (ny, nx), 1 where it is open."""
        rows = np.maximum.reduceat(layer, self._y, axis=0)
        np.maximum(self._sheet, np.maximum.reduceat(rows, self._x, axis=1), out=self._sheet)
        self._taken += 1
        if self._taken == self._block:
            self._end_sheet()

    def _end_sheet(self) -> None:
        self._done.append(self._sheet.copy())
        self._sheet[:] = 0
        self._taken = 0

    def longest(self) -> int:
        """Voxels along the longest of the shortest ways out, to within two blocks; 0 if nothing is open."""
        if self._taken:
            self._end_sheet()
        return _farthest(np.stack(self._done)) * self._block if self._done else 0


@jit
def _farthest(open_: NDArray[np.uint8]) -> int:
    """Steps from the border to the farthest open block that is reached; blocks that are reached are closed."""
    nz, ny, nx = open_.shape
    flat = open_.ravel()
    front = np.empty(flat.size, np.int32)
    n = 0
    for i in range(flat.size):
        z, y, x = i // (ny * nx), i // nx % ny, i % nx
        if flat[i] and (min(z, y, x) == 0 or z == nz - 1 or y == ny - 1 or x == nx - 1):
            front[n] = i
            n += 1
            flat[i] = 0
    # breadth-first search from all of the border at once: front[first:last] are the blocks of one
    # distance
    steps = first = 0
    while True:
        last = n
        for at in range(first, last):
            i = front[at]
            z, y, x = i // (ny * nx), i // nx % ny, i % nx
            for side in range(6):
                sign = 2 * (side % 2) - 1
                w, v, u = z + sign * (side // 2 == 0), y + sign * (side // 2 == 1), x + sign * (side // 2 == 2)
                if 0 <= w < nz and 0 <= v < ny and 0 <= u < nx:
                    other = (w * ny + v) * nx + u
                    if flat[other]:
                        flat[other] = 0
                        front[n] = other
                        n += 1
        if n == last:
            return steps
        steps += 1
        first = last
