"""Interpolation between a grid and the next coarser one, and its transpose.

A coarse axis has ``ceil(n / 2)`` voxels. Where n is even, its nodes are the even nodes of the fine axis. Where n is
odd, the fine axis, a ring, is taken from its second node on, and the voxel that is left over, the first, becomes the
last coarse one by itself: with the first voxel whole, no coarse voxel is ever shorter than half of the others. Nodes
between two coarse ones take their mean. An axis may keep its voxels, too, as the long one of elongated voxels does.

A grid may have open ends instead: its last voxels along each axis are void, and stay by themselves. A coarse axis then
has ``floor(n / 2) + 1`` voxels, the last of them void, so that a body never meets its own other end.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I64
from sppm_pipeline.services.jit.compiled import inline_jit, jit

_0, _1 = np.uint64(0), np.uint64(1)


def coarsened(fine: NDArray[Any], shape: tuple[int, ...] | None = None, *, open_ends: bool = False) -> NDArray[Any]:
    """Mean of the (up to) eight children of each coarse voxel, for any number of axes.

    Axes on which the coarse `shape` has as many voxels as the fine one stay as they are. With `open_ends` the last
    voxels are void whatever they hold.
    """
    for axis, n in enumerate(fine.shape):
        if shape is not None and shape[axis] == n:
            continue
        if open_ends:
            body = np.moveaxis(fine, axis, 0)[: n - 1]
            mean = np.zeros((n // 2 + 1, *body.shape[1:]), fine.dtype)
            mean[: n // 2] = body[0::2]
            mean[: (n - 1) // 2] += body[1::2]
            fine = np.moveaxis(mean * mean.dtype.type(0.5), 0, axis)
            continue
        ring = np.moveaxis(np.roll(fine, -1, axis) if n % 2 and n > 1 else fine, axis, 0)
        mean = ring[0::2].copy()
        mean[: n // 2] += ring[1::2]
        mean[: n // 2] *= mean.dtype.type(0.5)
        fine = np.moveaxis(mean, 0, axis)
    return np.ascontiguousarray(fine)


def coarser_widths(widths: list[F64], shape: tuple[int, ...] | None = None) -> list[F64]:
    """Widths of the coarse voxels along each axis, as parts of the width of a whole one; `shape` as for `coarsened`."""
    coarse = []
    for axis, width in enumerate(widths):
        mean = coarsened(width, None if shape is None else (shape[axis],))
        if len(width) % 2 and len(mean) < len(width):
            mean[-1] /= 2
        coarse.append(mean)
    return coarse


def shortness(widths: list[F64]) -> F64:
    """Factors for grids whose last voxel is shorter: it is stiffer across its width."""
    z, y, x = widths
    return 1 / (z[:, None, None] * y[:, None] * x)


@inline_jit
def _parents(i: Any, n: Any, m: Any, ring: Any) -> tuple[Any, Any]:
    """The coarse nodes on both sides of a node; twice the same one if it is one of them."""
    if m == n:
        return i, i
    i = (i + n - (n & ring)) % n
    return i >> _1, ((i + _1) >> _1) % m


@inline_jit
def _mean_of_rows(coarse: NDArray[Any], a: Any, b: Any, c: Any, d: Any, s: NDArray[Any], n: Any) -> None:
    quarter = s.dtype.type(0.25)
    for i in range(n):
        s[i] = quarter * ((coarse[a + i] + coarse[b + i]) + (coarse[c + i] + coarse[d + i]))


@inline_jit
def _interpolate_row(s: NDArray[Any], out: NDArray[Any], at: Any, n: Any, coarse: Any, ring: Any) -> None:
    half = s.dtype.type(0.5)
    if n == coarse:
        for i in range(n):
            out[at + i] += s[i]
        return
    if ring == _0:
        for i in range(n >> _1):
            out[at + i + i] += s[i]
            out[at + i + i + _1] += half * (s[i] + s[i + _1])
        if n & _1:
            out[at + n - _1] += s[coarse - _1]
        return
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
def interpolate_plane(
    coarse: NDArray[Any], z: Any, shapes: I64, out: NDArray[Any], at: Any, comp: Any, s: NDArray[Any]
) -> None:
    """Add the interpolated coarse vector to one plane of a fine one.

    Parameters
    ----------
    coarse : flat, of (components, nz, ny, nx)
    z : uint64
        The plane.
    shapes, s
        As `interpolate_add`.
    out : flat
        Receives the plane from `at` on, components `comp` apart.
    """
    nx, ny, nz = np.uint64(shapes[0]), np.uint64(shapes[1]), np.uint64(shapes[2])
    mx, my, mz, ring = np.uint64(shapes[3]), np.uint64(shapes[4]), np.uint64(shapes[5]), np.uint64(shapes[6])
    # twice the same coarse row where there is nothing to interpolate
    z0, z1 = _parents(z, nz, mz, ring)
    for c in range(np.uint64(len(coarse)) // (mx * my * mz)):
        low, high = (c * mz + z0) * my, (c * mz + z1) * my
        for line in range(ny):
            y0, y1 = _parents(line, ny, my, ring)
            _mean_of_rows(coarse, (low + y0) * mx, (low + y1) * mx, (high + y0) * mx, (high + y1) * mx, s, mx)
            _interpolate_row(s, out, at + c * comp + line * nx, nx, mx, ring)


@jit
def interpolate_add(coarse: NDArray[Any], out: NDArray[Any], shapes: I64, s: NDArray[Any]) -> None:
    """Add the interpolated coarse vector to a fine one.

    Parameters
    ----------
    coarse, out : flat, of (components, nz, ny, nx)
    shapes : (7,) int64
        nx, ny, nz of the fine and of the coarse grid; 1 if they are rings, 0 if their ends are open.
    s : (> nx of the coarse grid,)
        Scratch.
    """
    layer = np.uint64(shapes[0]) * np.uint64(shapes[1])
    planes = np.uint64(shapes[2])
    for z in range(planes):
        interpolate_plane(coarse, z, shapes, out, z * layer, planes * layer, s)


@inline_jit
def _ring_of_rows(
    fine: NDArray[Any], low: Any, middle: Any, high: Any, before: Any, after: Any, s: NDArray[Any], n: Any, odd: Any
) -> None:
    """The sum of three rows, the outer ones weighted, as a ring, in ``s[1:]``; `odd` if the first node comes last."""
    for i in range(n - odd):
        k = odd + i
        s[i + _1] = fine[middle + k] + (before * fine[low + k] + after * fine[high + k])
    if odd != _0:
        s[n] = fine[middle] + (before * fine[low] + after * fine[high])


@inline_jit
def _restrict_row(s: NDArray[Any], out: NDArray[Any], at: Any, factor: Any, n: Any, coarse: Any, odd: Any) -> None:
    half = s.dtype.type(0.5)
    if n == coarse:  # in the order that `_ring_of_rows` has changed
        for i in range(n):
            out[at + i] += factor * s[(i + n - odd) % n + _1]
        return
    for i in range(coarse):
        out[at + i] += factor * (s[i + i + _1] + half * (s[i + i] + s[i + i + _1 + _1]))


@jit
def restrict_plane(
    fine: NDArray[Any], at: Any, comp: Any, z: Any, shapes: I64, out: NDArray[Any], s: NDArray[Any]
) -> None:
    """Add the part of one plane to a restricted vector: the transpose of `interpolate_plane`.

    Parameters
    ----------
    fine : flat
        The plane begins at `at`, components `comp` apart.
    z : uint64
        The plane.
    shapes, s
        As `restrict`.
    out : flat, of (components, nz, ny, nx)
    """
    nx, ny, nz = np.uint64(shapes[0]), np.uint64(shapes[1]), np.uint64(shapes[2])
    mx, my, mz, ring = np.uint64(shapes[3]), np.uint64(shapes[4]), np.uint64(shapes[5]), np.uint64(shapes[6])
    zero, half, one = s.dtype.type(0), s.dtype.type(0.5), s.dtype.type(1)
    odd, odd_x = ny & ring, nx & ring
    closed = ring != _0 and odd == _0
    z0, z1 = _parents(z, nz, mz, ring)
    for c in range(np.uint64(len(out)) // (mx * my * mz)):
        rows = at + c * comp
        for y in range(my):
            # the line before, the line itself, the line after, unless the ring is open there
            low, middle, high = (y + y + ny - _1 + odd) % ny, (y + y + odd) % ny, (y + y + _1 + odd) % ny
            before = zero if not closed and y == _0 else half
            after = zero if not closed and y + _1 == my else half
            if my == ny:
                low = middle = high = np.uint64(y)
                before = after = zero
            elif ring == _0 and y + y == ny:
                middle = low  # half of the last line, beyond which this node lies
                before = -half
            _ring_of_rows(fine, rows + low * nx, rows + middle * nx, rows + high * nx, before, after, s, nx, odd_x)
            # an even number of nodes closes the ring between its last node and the first
            s[_0] = s[nx] if ring != _0 and odd_x == _0 else zero
            s[nx + _1] = zero
            s[nx + _1 + _1] = zero
            to = ((c * mz + z0) * my + y) * mx
            if z0 == z1:
                _restrict_row(s, out, to, one, nx, mx, odd_x)
            else:
                _restrict_row(s, out, to, half, nx, mx, odd_x)
                _restrict_row(s, out, ((c * mz + z1) * my + y) * mx, half, nx, mx, odd_x)


@jit
def restrict(fine: NDArray[Any], out: NDArray[Any], shapes: I64, s: NDArray[Any]) -> None:
    """The transpose of the interpolation; arguments as `interpolate_add`, `s` longer than nx + 2 of the fine grid."""
    layer = np.uint64(shapes[0]) * np.uint64(shapes[1])
    planes = np.uint64(shapes[2])
    out[:] = 0
    for z in range(planes):
        restrict_plane(fine, z * layer, planes * layer, z, shapes, out, s)


class NodalTransfer(NamedTuple):
    """Between the nodes of two grids; see `hierarchy.Transfer`.

    Attributes
    ----------
    shapes : (7,) int64
        As `restrict` takes them.
    """

    shapes: I64

    @classmethod
    def between(
        cls, fine: tuple[int, int, int], coarse: tuple[int, int, int], *, open_ends: bool = False
    ) -> NodalTransfer:
        """From the voxels (nz, ny, nx) of both grids."""
        return cls(np.array([*fine[::-1], *coarse[::-1], not open_ends], np.int64))

    def restrict(self, fine: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """See `restrict`."""
        restrict(fine, out, self.shapes, line)

    def interpolate_add(self, coarse: NDArray[Any], out: NDArray[Any], line: NDArray[Any]) -> None:
        """See `interpolate_add`."""
        interpolate_add(coarse, out, self.shapes, line)
