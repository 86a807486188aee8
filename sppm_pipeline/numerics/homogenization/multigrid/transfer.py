"""Interpolation between a grid and the next coarser one, and its transpose.

A coarse axis has ``ceil(n / 2)`` voxels. Where n is even, its nodes are the even nodes of the fine axis. Where n is
odd, the fine axis, a ring, is taken from its second node on, and the voxel that is left over, the first, becomes the
last coarse one by itself: with the first voxel whole, no coarse voxel is ever shorter than half of the others. Nodes
between two coarse ones take their mean.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import inline_jit, jit

_0, _1 = np.uint64(0), np.uint64(1)


def coarsened(fine: NDArray[Any]) -> NDArray[Any]:
    """Mean of the (up to) eight children of each coarse voxel, for any number of axes."""
    for axis, n in enumerate(fine.shape):
        ring = np.moveaxis(np.roll(fine, -1, axis) if n % 2 and n > 1 else fine, axis, 0)
        mean = ring[0::2].copy()
        mean[: n // 2] += ring[1::2]
        mean[: n // 2] *= mean.dtype.type(0.5)
        fine = np.moveaxis(mean, 0, axis)
    return np.ascontiguousarray(fine)


def coarser_widths(widths: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
    """Widths of the coarse voxels along each axis, as parts of the width of a whole one."""
    coarse = []
    for width in widths:
        mean = coarsened(width)
        if len(width) % 2 and len(width) > 1:
            mean[-1] /= 2
        coarse.append(mean)
    return coarse


def shortness(widths: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Factors for grids whose last voxel is shorter: it is stiffer across its width."""
    z, y, x = widths
    return 1 / (z[:, None, None] * y[:, None] * x)


@inline_jit
def _add_scaled(a: NDArray[Any], at: Any, factor: Any, s: NDArray[Any], n: Any) -> None:
    for i in range(n):
        s[i] += factor * a[at + i]


@inline_jit
def _interpolate_row(s: NDArray[Any], out: NDArray[Any], at: Any, n: Any, coarse: Any) -> None:
    half = s.dtype.type(0.5)
    if n & _1 == _0:
        s[coarse] = s[_0]
        for i in range(coarse):
            out[at + i + i] += s[i]
            out[at + i + i + _1] += half * (s[i] + s[i + _1])
        return
    out[at] += s[coarse - _1]
    at += _1
    for i in range(coarse - _1):
        out[at + i + i] += s[i]
        out[at + i + i + _1] += half * (s[i] + s[i + _1])


@jit
def interpolate_add(coarse: NDArray[Any], out: NDArray[Any], shapes: NDArray[np.int64], s: NDArray[Any]) -> None:
    """Add the interpolated coarse vector to a fine one.

    Parameters
    ----------
    coarse, out : flat, of (components, nz, ny, nx)
    shapes : (6,) int64
        nx, ny, nz of the fine and of the coarse grid.
    s : (> nx of the coarse grid,)
        Scratch.
    """
    nx, ny, nz = np.uint64(shapes[0]), np.uint64(shapes[1]), np.uint64(shapes[2])
    mx, my, mz = np.uint64(shapes[3]), np.uint64(shapes[4]), np.uint64(shapes[5])
    quarter = s.dtype.type(0.25)
    components = np.uint64(len(out)) // (nx * ny * nz)
    for line in range(components * nz * ny):
        y, z, c = line % ny, (line // ny) % nz, line // (ny * nz)
        # places on the ring; twice the same coarse row where there is nothing to interpolate
        y, z = (y + ny - (ny & _1)) % ny, (z + nz - (nz & _1)) % nz
        y0, y1, z0, z1 = y >> _1, ((y + _1) >> _1) % my, z >> _1, ((z + _1) >> _1) % mz
        for i in range(mx):
            s[i] = s.dtype.type(0)
        _add_scaled(coarse, ((c * mz + z0) * my + y0) * mx, quarter, s, mx)
        _add_scaled(coarse, ((c * mz + z0) * my + y1) * mx, quarter, s, mx)
        _add_scaled(coarse, ((c * mz + z1) * my + y0) * mx, quarter, s, mx)
        _add_scaled(coarse, ((c * mz + z1) * my + y1) * mx, quarter, s, mx)
        _interpolate_row(s, out, line * nx, nx, mx)


@inline_jit
def _add_ring(a: NDArray[Any], at: Any, factor: Any, s: NDArray[Any], n: Any) -> None:
    """Add a row as a ring, to ``s[1:]``."""
    odd = n & _1
    for i in range(n - odd):
        s[i + _1] += factor * a[at + odd + i]
    if odd != _0:
        s[n] += factor * a[at]


@inline_jit
def _restrict_row(s: NDArray[Any], out: NDArray[Any], at: Any, n: Any, coarse: Any) -> None:
    half = s.dtype.type(0.5)
    # an even number of nodes closes the ring between its last node and the first
    s[_0] = s[n] if n & _1 == _0 else s.dtype.type(0)
    s[n + _1] = s.dtype.type(0)
    for i in range(coarse):
        out[at + i] = s[i + i + _1] + half * (s[i + i] + s[i + i + _1 + _1])


@jit
def restrict(fine: NDArray[Any], out: NDArray[Any], shapes: NDArray[np.int64], s: NDArray[Any]) -> None:
    """The transpose of the interpolation; arguments as `interpolate_add`, `s` longer than nx + 1 of the fine grid."""
    nx, ny, nz = np.uint64(shapes[0]), np.uint64(shapes[1]), np.uint64(shapes[2])
    mx, my, mz = np.uint64(shapes[3]), np.uint64(shapes[4]), np.uint64(shapes[5])
    components = np.uint64(len(fine)) // (nx * ny * nz)
    three = np.uint64(3)
    for line in range(components * mz * my):
        y, z, c = line % my, (line // my) % mz, line // (my * mz)
        for i in range(nx + _1 + _1):
            s[i] = s.dtype.type(0)
        # the node before, the node itself, the node after, unless the ring is open there
        for k in range(three):
            if nz & _1 != _0 and ((k == _0 and z == _0) or (k > _1 and z + _1 == mz)):
                continue
            z1 = (z + z + k + nz - _1 + (nz & _1)) % nz
            for j in range(three):
                if ny & _1 != _0 and ((j == _0 and y == _0) or (j > _1 and y + _1 == my)):
                    continue
                y1 = (y + y + j + ny - _1 + (ny & _1)) % ny
                factor = (1.0 if k == _1 else 0.5) * (1.0 if j == _1 else 0.5)
                _add_ring(fine, ((c * nz + z1) * ny + y1) * nx, s.dtype.type(factor), s, nx)
        _restrict_row(s, out, line * mx, nx, mx)


class NodalTransfer(NamedTuple):
    """Between the nodes of two grids; see `hierarchy.Transfer`.

    Attributes
    ----------
    shapes : (6,) int64
        As `restrict` takes them.
    """

    shapes: NDArray[np.int64]

    @classmethod
    def between(cls, fine: tuple[int, int, int], coarse: tuple[int, int, int]) -> NodalTransfer:
        """From the voxels (nz, ny, nx) of both grids."""
        return cls(np.array([*fine[::-1], *coarse[::-1]], np.int64))

    def restrict(self, fine: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """See `restrict`."""
        restrict(fine, out, self.shapes, line)

    def interpolate_add(self, coarse: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """See `interpolate_add`."""
        interpolate_add(coarse, out, self.shapes, line)
