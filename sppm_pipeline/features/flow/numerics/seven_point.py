"""Seven-point operators on periodic grids with walls, their coarse grids, and the multigrid cycle for them.

An unknown is joined to its six neighbors by weights, which are 0 across walls, and to the walls by their drag. Coarse
grids unite 2 x 2 x 2 unknowns, and are for velocities, which are zero at walls: they are interpolated linearly between
centers. Half the sum of the fine weights joins coarse unknowns, for their distance is twice that of fine ones.
Pressures, which jump across walls, have the coarse grids of `channel_grids`.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics import BLOCK, HEAD, STRIDE, Hierarchy, Workspace, coarser, finish_row, inline_jit, jit

#: Rows of scratch: a row of unknowns, the weights along it, what becomes of it.
SCRATCH_ROWS = 3

_DAMPING = 0.8
"""Of the Jacobi smoother, whose bound is 1 here: measured best of 0.5, 0.66, 0.8 on cells of the paper and gyroids."""

_MAX_EIGENVALUE = 2.0
"""Of the eigenvalues of the matrix over its diagonal, which is the sum of the others in its row at least."""

_FAR_WEIGHT = np.float32(0.25)
"""Share of the second nearest coarse unknown along an axis in the interpolation; the nearest has the rest."""

_0, _1 = np.uint64(0), np.uint64(1)
_HEAD, _BLOCK = np.uint64(HEAD), np.uint64(BLOCK)
_W, _F = np.uint64(STRIDE), np.uint64(2 * STRIDE)


@inline_jit
def _halo(a: NDArray[Any], row: Any, n: Any, start: Any, width: Any, s: NDArray[Any], to: Any) -> None:
    """A part of a row with the entry before and the one after it, periodic."""
    for i in range(width):
        s[to + i] = a[row + start + i]
    s[to - _1] = a[row + (start if start > _0 else n) - _1]
    s[to + width] = a[row + (start + width if start + width < n else _0)]


@inline_jit
def _along(d: NDArray[Any], at: Any, s: NDArray[Any], width: Any) -> None:
    for i in range(_HEAD, _HEAD + width):
        s[_F + i] = d[at - _HEAD + i] * s[i] - s[_W + i] * s[i - _1] - s[_W + i + _1] * s[i + _1]


@inline_jit
def _beside(w: NDArray[Any], wat: Any, v: NDArray[Any], vat: Any, s: NDArray[Any], width: Any) -> None:
    for i in range(width):
        s[_F + _HEAD + i] -= w[wat + i] * v[vat + i]


@jit
def apply_seven_point(
    mode: int, v: NDArray[Any], r: NDArray[Any], weight: NDArray[Any], diagonal: NDArray[Any], wx: NDArray[Any],
    wy: NDArray[Any], wz: NDArray[Any], shape: NDArray[np.int64], out: NDArray[Any], s: NDArray[Any],
) -> float:  # fmt: skip
    """The operator, or what a solver needs of it; compare `elastic_operator.apply_stiffness`.

    All arrays are (nz, ny, nx) flat, but for `shape` (nx, ny, nz) and the scratch `s` (SCRATCH_ROWS * STRIDE,); `wx`,
    `wy`, `wz` are the weights between each unknown and the one before it along the axis.
    """
    n, lines, planes = np.uint64(shape[0]), np.uint64(shape[1]), np.uint64(shape[2])
    total = 0.0
    for z in range(planes):
        below, above = (z + planes - _1) % planes, (z + _1) % planes
        for y in range(lines):
            row = (z * lines + y) * n
            before, behind = (z * lines + (y + lines - _1) % lines) * n, (z * lines + (y + _1) % lines) * n
            low, high = (below * lines + y) * n, (above * lines + y) * n
            for start in range(_0, n, _BLOCK):
                width = min(_BLOCK, n - start)
                _halo(v, row, n, start, width, s, _HEAD)
                _halo(wx, row, n, start, width, s, _W + _HEAD)
                _along(diagonal, row + start, s, width)
                _beside(wy, row + start, v, before + start, s, width)
                _beside(wy, behind + start, v, behind + start, s, width)
                _beside(wz, row + start, v, low + start, s, width)
                _beside(wz, high + start, v, high + start, s, width)
                at = row + start
                total += finish_row(mode, v, r, at, weight, at, s, _F + _HEAD, out, width)
    return total


class SevenPointLevel:
    """One grid; see `multigrid.hierarchy.Level`.

    `walls` (nz, ny, nx) is the drag of the walls, 0 where there is none; `weights`, three such arrays, join each
    unknown and the one before it along x, y, z; 0 across walls. Unknowns without any are none.
    """

    components = 1

    def __init__(self, walls: NDArray[np.float32], weights: tuple[NDArray[np.float32], ...]) -> None:
        nz, ny, nx = walls.shape
        self.shape = (nz, ny, nx)
        self.size = np.array([nx, ny, nz], np.int64)
        diagonal = walls.copy()
        for axis, w in zip((2, 1, 0), weights, strict=True):
            diagonal += w
            diagonal += np.roll(w, -1, axis)
        self.diagonal = diagonal.reshape(-1)
        self.weights = tuple(np.ascontiguousarray(w).reshape(-1) for w in weights)
        self.weight = np.zeros_like(self.diagonal)

    def apply(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], work: Workspace) -> float:
        """See `apply_seven_point`."""
        return self.apply_by(mode, v, r, out, work.rows)

    def apply_by(self, mode: int, v: NDArray[Any], r: NDArray[Any], out: NDArray[Any], rows: NDArray[Any]) -> float:
        """The same for vectors of another precision, which `rows` has as well."""
        wx, wy, wz = self.weights
        return apply_seven_point(mode, v, r, self.weight, self.diagonal, wx, wy, wz, self.size, out, rows)


def _united(values: NDArray[np.float32], axes: tuple[int, ...]) -> NDArray[np.float32]:
    """Sums over the pairs of some axes; an odd last one stays alone."""
    for axis in axes:
        ring = np.moveaxis(values, axis, 0)
        total = ring[0::2].copy()
        total[: len(ring) // 2] += ring[1::2]
        values = np.moveaxis(total, 0, axis)
    return values


def hierarchy_of(walls: NDArray[np.float32], weights: tuple[NDArray[np.float32], ...]) -> Hierarchy:
    """All grids, the coarsest of two unknowns along an axis at most; arguments as of a `SevenPointLevel`."""
    levels = [SevenPointLevel(walls, weights)]
    while coarser(levels[-1].shape) is not None:
        # halved like the weights, as the distance from the wall doubles, too
        walls = np.float32(0.5) * _united(walls, (0, 1, 2))
        coarse = []
        for d, w in enumerate(weights):
            across = 2 - d
            # only weights between the pairs count
            low = np.moveaxis(np.moveaxis(w, across, 0)[0::2], 0, across)
            coarse.append(np.float32(0.5) * _united(low, tuple(axis for axis in range(3) if axis != across)))
        weights = tuple(coarse)
        levels.append(SevenPointLevel(np.ascontiguousarray(walls), weights))
    return Hierarchy.of(
        list(levels), SCRATCH_ROWS, _MAX_EIGENVALUE,
        transfers=[CellTransfer(fine, coarse) for fine, coarse in pairwise(levels)], damping=_DAMPING,
    )  # fmt: skip


class CellTransfer(NamedTuple):
    """Between the unknowns of two grids; see `multigrid.hierarchy.Transfer`."""

    fine: SevenPointLevel
    coarse: SevenPointLevel

    def restrict(self, fine: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """The transpose of the interpolation; residuals are 0 where there is no unknown."""
        restrict_cells(fine, out, self.coarse.weight, self.fine.size, self.coarse.size, _FAR_WEIGHT, line)

    def interpolate_add(self, coarse: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """Add the interpolated vector where there are unknowns."""
        interpolate_cells_add(coarse, out, self.fine.weight, self.fine.size, self.coarse.size, _FAR_WEIGHT, line)


@inline_jit
def _add_scaled(a: NDArray[Any], at: Any, factor: Any, s: NDArray[Any], n: Any) -> None:
    for i in range(n):
        s[i + _1] += factor * a[at + i]


@inline_jit
def _spread(s: NDArray[Any], w: NDArray[Any], out: NDArray[Any], at: Any, n: Any, m: Any, far: Any) -> None:
    """Interpolate a row of coarse values, which begins at ``s[1]``, and add it where there are unknowns."""
    near, nothing = s.dtype.type(1) - far, s.dtype.type(0)
    s[_0], s[m + _1] = s[m], s[_1]
    for j in range(n >> _1):
        i = at + j + j
        low, high = near * s[j + _1] + far * s[j], near * s[j + _1] + far * s[j + _1 + _1]
        out[i] += low if w[i] > nothing else nothing
        out[i + _1] += high if w[i + _1] > nothing else nothing
    if n & _1 != _0 and w[at + n - _1] > nothing:
        # the last of an odd row lies in the lower half of its coarse unknown, next to the one before
        out[at + n - _1] += near * s[m] + far * s[m - _1]


@inline_jit
def _collect(fine: NDArray[Any], at: Any, n: Any, m: Any, far: Any, s: NDArray[Any]) -> None:
    """The transpose: from a row of fine values to the coarse ones at ``s[1]``."""
    near, nothing = s.dtype.type(1) - far, s.dtype.type(0)
    for j in range(m + _1 + _1):
        s[j] = nothing
    for j in range(n >> _1):
        low, high = fine[at + j + j], fine[at + j + j + _1]
        s[j] += far * low
        s[j + _1] += near * (low + high)
        s[j + _1 + _1] += far * high
    if n & _1 != _0:
        s[m] += near * fine[at + n - _1]
        s[m - _1] += far * fine[at + n - _1]
    # the ring: what stands before the first belongs to the last, in turn
    s[m] += s[_0]
    s[_1] += s[m + _1]


@jit
def interpolate_cells_add(
    coarse: NDArray[Any], out: NDArray[Any], weight: NDArray[Any], fine_size: NDArray[np.int64],
    coarse_size: NDArray[np.int64], far: Any, s: NDArray[Any],
) -> None:  # fmt: skip
    """Add the interpolated coarse vector to a fine one, where `weight` is not 0.

    `coarse`, `out` and `weight` are flat, of (nz, ny, nx), sizes (nx, ny, nz); `far` is the share of the second
    nearest coarse unknown along an axis, the nearest has the rest; `s` is scratch of more than nx + 1 of the fine
    grid.
    """
    nx, ny, nz = np.uint64(fine_size[0]), np.uint64(fine_size[1]), np.uint64(fine_size[2])
    mx, my, mz = np.uint64(coarse_size[0]), np.uint64(coarse_size[1]), np.uint64(coarse_size[2])
    near = s.dtype.type(1) - far
    for z in range(nz):
        z0 = z >> _1
        z1 = (z0 + (_1 if z & _1 != _0 else mz - _1)) % mz
        for y in range(ny):
            y0 = y >> _1
            y1 = (y0 + (_1 if y & _1 != _0 else my - _1)) % my
            for i in range(_1, mx + _1):
                s[i] = s.dtype.type(0)
            _add_scaled(coarse, (z0 * my + y0) * mx, near * near, s, mx)
            _add_scaled(coarse, (z0 * my + y1) * mx, near * far, s, mx)
            _add_scaled(coarse, (z1 * my + y0) * mx, near * far, s, mx)
            _add_scaled(coarse, (z1 * my + y1) * mx, far * far, s, mx)
            _spread(s, weight, out, (z * ny + y) * nx, nx, mx, far)


@inline_jit
def _gather(s: NDArray[Any], out: NDArray[Any], at: Any, factor: Any, n: Any) -> None:
    for i in range(n):
        out[at + i] += factor * s[i + _1]


@jit
def restrict_cells(
    fine: NDArray[Any], out: NDArray[Any], weight: NDArray[Any], fine_size: NDArray[np.int64],
    coarse_size: NDArray[np.int64], far: Any, s: NDArray[Any],
) -> None:  # fmt: skip
    """The transpose of `interpolate_cells_add`, 0 where `weight`, of the coarse grid here, is 0; arguments as there."""
    nx, ny, nz = np.uint64(fine_size[0]), np.uint64(fine_size[1]), np.uint64(fine_size[2])
    mx, my, mz = np.uint64(coarse_size[0]), np.uint64(coarse_size[1]), np.uint64(coarse_size[2])
    near = s.dtype.type(1) - far
    for i in range(len(out)):
        out[i] = out.dtype.type(0)
    for z in range(nz):
        z0 = z >> _1
        z1 = (z0 + (_1 if z & _1 != _0 else mz - _1)) % mz
        for y in range(ny):
            y0 = y >> _1
            y1 = (y0 + (_1 if y & _1 != _0 else my - _1)) % my
            # a row of the fine grid becomes one of the coarse grid, which four of its rows receive
            _collect(fine, (z * ny + y) * nx, nx, mx, far, s)
            _gather(s, out, (z0 * my + y0) * mx, near * near, mx)
            _gather(s, out, (z0 * my + y1) * mx, near * far, mx)
            _gather(s, out, (z1 * my + y0) * mx, near * far, mx)
            _gather(s, out, (z1 * my + y1) * mx, far * far, mx)
    for i in range(len(out)):
        if weight[i] == 0:
            out[i] = out.dtype.type(0)
