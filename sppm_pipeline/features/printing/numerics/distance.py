"""Distances in a stack of layers that come one by one, as far as a reach; and the same layers with larger voxels.

Squared distances add up along the axes, so a pass along each axis gives exact Euclidean distances; each looks only as
far as the reach. The pass along z needs a ring of twice the reach in layers, and nothing else is kept.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.jit.compiled import inline_jit, jit

UNREACHED = np.float32(np.inf)

_SLACK = 1.0 + 1e-5  # float32 squares that equal a bound up to rounding count as within


class StreamedDistance:
    """Squared distance of each voxel to the nearest marked one; exact up to `reach`, infinite beyond.

    `shape` is (nx, ny), `pitch` that of the voxels along x, y, z in the unit of `reach`.
    """

    def __init__(self, shape: tuple[int, int], pitch: tuple[float, float, float], reach: float) -> None:
        self._shape = shape[::-1]
        self._pitch, self._cap = pitch, np.float32((reach * _SLACK) ** 2)
        self._reach = tuple(math.floor(reach / h * _SLACK) for h in pitch)
        self._ring: deque[NDArray[np.float32]] = deque()
        self._before = 0  # layers of the ring below the one that is finished next

    def add(self, marked: NDArray[np.uint8]) -> Iterator[NDArray[np.float32]]:
        """Take in the next layer, (ny, nx), marked where it is not 0; yields the layers that are finished by it."""
        hx, hy, _ = self._pitch
        rows = np.empty(self._shape, np.float32)
        _along_rows(marked, self._reach[0], np.float32(hx * hx), rows)
        plane = np.empty_like(rows)
        _across_rows(rows, self._reach[1], np.float32(hy * hy), plane)
        self._ring.append(plane)
        if len(self._ring) - 1 - self._before >= self._reach[2]:
            yield self._finished()

    def finish(self) -> Iterator[NDArray[np.float32]]:
        """The layers that waited for more above them."""
        while self._before < len(self._ring):
            yield self._finished()

    def _finished(self) -> NDArray[np.float32]:
        h2 = np.float32(self._pitch[2] ** 2)
        out = self._ring[self._before].copy()
        for i, plane in enumerate(self._ring):
            if 0 < abs(i - self._before) <= self._reach[2]:
                _lower(out.ravel(), plane.ravel(), h2 * np.float32((i - self._before) ** 2))
        out[out > self._cap] = UNREACHED
        # the lowest layer of a full ring is too far from the next one to be finished
        if self._before == self._reach[2]:
            self._ring.popleft()
        else:
            self._before += 1
        return out


class Coarsened:
    """Layers with voxels larger by whole factors along x, y, z: solid where at least half of the voxels inside are.

    `shape` is (nx, ny). Incomplete blocks at the far ends are filled up with void.
    """

    def __init__(self, shape: tuple[int, int], factors: tuple[int, int, int]) -> None:
        self._factors = factors
        self.shape = (-(-shape[0] // factors[0]), -(-shape[1] // factors[1]))
        self._sum = np.zeros(self.shape[::-1], np.int32)
        self._taken = 0

    def add(self, layer: NDArray[np.uint8]) -> Iterator[NDArray[np.uint8]]:
        """Take in the next layer of zeros and ones; yields a coarse one whenever there are enough."""
        _add_blocks(layer, self._factors[0], self._factors[1], self._sum)
        self._taken += 1
        if self._taken == self._factors[2]:
            yield from self.finish()

    def finish(self) -> Iterator[NDArray[np.uint8]]:
        """The last coarse layer, if it is incomplete."""
        if self._taken:
            yield (2 * self._sum >= math.prod(self._factors)).view(np.uint8)
            self._sum[:] = 0
            self._taken = 0


def coarse_factors(pitch: tuple[float, float, float], voxel: float) -> tuple[int, int, int]:
    """Voxels along x, y, z that together measure at most `voxel`, at least one."""
    x, y, z = (max(1, math.floor(voxel / h * _SLACK)) for h in pitch)
    return x, y, z


@jit
def _along_rows(marked: NDArray[np.uint8], reach: int, h2: np.float32, out: NDArray[np.float32]) -> None:
    ny, nx = marked.shape
    for y in range(ny):
        far = reach + 1
        for x in range(nx):
            far = 0 if marked[y, x] else far + 1
            out[y, x] = h2 * np.float32(far * far) if far <= reach else UNREACHED
        far = reach + 1
        for x in range(nx - 1, -1, -1):
            far = 0 if marked[y, x] else far + 1
            if far <= reach:
                out[y, x] = min(out[y, x], h2 * np.float32(far * far))


@inline_jit
def _lower(target: NDArray[np.float32], other: NDArray[np.float32], plus: np.float32) -> None:
    for i in range(target.size):
        target[i] = min(target[i], other[i] + plus)


@jit
def _across_rows(rows: NDArray[np.float32], reach: int, h2: np.float32, out: NDArray[np.float32]) -> None:
    ny = rows.shape[0]
    for y in range(ny):
        out[y] = rows[y]
        for other in range(max(0, y - reach), min(ny, y + reach + 1)):
            if other != y:
                _lower(out[y], rows[other], h2 * np.float32((other - y) * (other - y)))


@jit
def _add_blocks(layer: NDArray[np.uint8], fx: int, fy: int, total: NDArray[np.int32]) -> None:
    ny, nx = layer.shape
    for y in range(ny):
        row = total[y // fy]
        for x in range(nx):
            row[x // fx] += layer[y, x]
