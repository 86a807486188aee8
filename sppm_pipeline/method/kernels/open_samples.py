"""Sums of kernels at the samples of a grid that are left open, and whether they lie below a level.

The open samples of a brick are summed together, so that the loop over them is a vector loop whatever their places. A
sample's sum is that of all kernels within reach, in their order: it depends on the place of the sample in the grid and
on nothing else. Kernels are rows of numbers, see `packed_capsules`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.method.kernels.profiles import TunnelProfile
from sppm_pipeline.method.kernels.rows import LANES, exp2_minus, exponent
from sppm_pipeline.services.jit.compiled import inline_jit, jit, specialized

# Bricks of samples whose open ones are summed together: the powers of 2 that are their sides along x, y and z. So many
# bricks along x share a list of kernels.
_BITS, _LONG = (4, 3, 3), 8
_BRICK = (1 << _BITS[0], 1 << _BITS[1], 1 << _BITS[2])


@inline_jit
def _add_balls(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    z: NDArray[np.float32],
    n: np.uint64,
    u: NDArray[np.float32],
    reach2: np.float32,
    sums: NDArray[np.float32],
) -> None:
    """Add ``2^-|U p + o|^2`` at n points p; `u` holds U and then o."""
    a, b, c, d, e, f = u[0], u[1], u[2], u[3], u[4], u[5]
    ox, oy, oz = u[6], u[7], u[8]
    for i in range(n):
        # U is upper triangular: the square root of a metric needs six numbers, not nine
        px = a * x[i] + b * y[i] + c * z[i] + ox
        py = d * y[i] + e * z[i] + oy
        pz = f * z[i] + oz
        r2 = np.float32(px * px + py * py + pz * pz)
        value = exp2_minus(r2)
        sums[i] += value if r2 <= reach2 else np.float32(0)


def add_capsules(
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    z: NDArray[np.float32],
    n: np.uint64,
    u: NDArray[np.float32],
    reach2: np.float32,
    sums: NDArray[np.float32],
) -> None:
    """Add ``2^-exponent(d^2)`` at n points, d the distance of U p + o from the segment from 0; `u` also holds that.

    Compiled once for each tunnel profile.
    """
    a, b, c, d, e, f = u[0], u[1], u[2], u[3], u[4], u[5]
    ox, oy, oz = u[6], u[7], u[8]
    ux, uy, uz, length = u[9], u[10], u[11], u[12]
    for i in range(n):
        px = a * x[i] + b * y[i] + c * z[i] + ox
        py = d * y[i] + e * z[i] + oy
        pz = f * z[i] + oz
        s = min(max(ux * px + uy * py + uz * pz, np.float32(0)), length)
        px, py, pz = px - s * ux, py - s * uy, pz - s * uz
        r2 = np.float32(px * px + py * py + pz * pz)
        value = exp2_minus(exponent(r2))
        sums[i] += value if r2 <= reach2 else np.float32(0)


@inline_jit
def _near(
    seen: NDArray[np.float32],
    n: np.uint64,
    mid: NDArray[np.float32],
    half: NDArray[np.float32],
    reach: np.float32,
    near: NDArray[np.uint8],
) -> None:
    """True if one of the first n listed kernels, see `_list`, comes near a box."""
    mx, my, mz, hx, hy, hz = mid[0], mid[1], mid[2], half[0], half[1], half[2]
    for i in range(n):
        x, y, z = mx - seen[0, i], my - seen[1, i], mz - seen[2, i]
        px = seen[3, i] * x + seen[4, i] * y + seen[5, i] * z
        py = seen[6, i] * y + seen[7, i] * z
        pz = seen[8, i] * z
        s = min(max(seen[9, i] * px + seen[10, i] * py + seen[11, i] * pz, np.float32(0)), seen[12, i])
        px, py, pz = px - s * seen[9, i], py - s * seen[10, i], pz - s * seen[11, i]
        a = abs(seen[3, i]) * hx + abs(seen[4, i]) * hy + abs(seen[5, i]) * hz
        b, c = abs(seen[6, i]) * hy + abs(seen[7, i]) * hz, abs(seen[8, i]) * hz
        away = np.float32(math.sqrt(px * px + py * py + pz * pz))
        near[i] = np.uint8(away <= reach + np.float32(math.sqrt(a * a + b * b + c * c)))


@inline_jit
def _seen_from(c: NDArray[np.float64], anchor: NDArray[np.float64], u: NDArray[np.float32]) -> None:
    """Write what `add_capsules` has to know of a kernel where points are counted from `anchor`."""
    x, y, z = anchor[0] - c[0], anchor[1] - c[1], anchor[2] - c[2]
    for i in range(6):
        u[i] = np.float32(c[3 + i])
    u[6] = np.float32(c[3] * x + c[4] * y + c[5] * z)
    u[7] = np.float32(c[6] * y + c[7] * z)
    u[8] = np.float32(c[8] * z)
    for i in range(4):
        u[9 + i] = np.float32(c[9 + i])


@jit
def _by_rows(
    capsules: NDArray[np.float64], low_z: float, high_z: float, origin: float, side: float, rows: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Start of the kernels of each row of bricks, `side` wide, in a list, and that list; each row is in order."""
    begin = np.zeros(rows + 1, np.int64)
    first, last = np.empty(len(capsules), np.int32), np.empty(len(capsules), np.int32)
    for i in range(len(capsules)):
        first[i], last[i] = 0, -1
        if capsules[i, 15] <= high_z and capsules[i, 18] >= low_z:
            first[i] = max(0, math.floor((capsules[i, 14] - origin) / side))
            last[i] = min(rows - 1, math.floor((capsules[i, 17] - origin) / side))
        for row in range(first[i], last[i] + 1):
            begin[row + 1] += 1
    begin = np.cumsum(begin)
    place = begin[:-1].copy()
    listed = np.empty(begin[-1], np.int64)
    for i in range(len(capsules)):
        for row in range(first[i], last[i] + 1):
            listed[place[row]] = i
            place[row] += 1
    return begin, listed


@inline_jit
def _list(
    capsules: NDArray[np.float64],
    among: NDArray[np.int64],
    start: int,
    stop: int,
    low: float,
    high: float,
    anchor: NDArray[np.float64],
    found: NDArray[np.int64],
    seen: NDArray[np.float32],
) -> int:
    """Number of the kernels ``among[start:stop]`` that reach some samples along x; listed as seen from a point."""
    count = 0
    for i in range(start, stop):
        c = among[i]
        found[count] = c
        count += int((capsules[c, 13] <= high) & (capsules[c, 16] >= low))
    for i in range(count):
        c = capsules[found[i]]
        for axis in range(3):
            seen[axis, i] = np.float32(c[axis] - anchor[axis])
        for column in range(3, 13):
            seen[column, i] = np.float32(c[column])
    return count


@inline_jit
def _gather(
    open_x: NDArray[np.int32],
    next_open: NDArray[np.int64],
    last_open: NDArray[np.int64],
    i0: int,
    j_start: int,
    j_stop: int,
    k_start: int,
    k_stop: int,
    place: NDArray[np.int32],
    source: NDArray[np.int64],
    rows: NDArray[np.int64],
) -> int:
    """Places of the open samples in a brick, their number, and the first and last rows and layers that have such."""
    bx, by, bz = _BRICK
    n, end = 0, i0 + bx
    rows[0], rows[1], rows[2], rows[3] = by, -1, bz, -1
    for k in range(k_start, k_stop):
        for j in range(j_start, j_stop):
            number = k * by + j
            at, last = next_open[number], last_open[number]
            if at == last or open_x[at] >= end:
                continue
            base = np.int32(number * bx - i0)
            while at < last and open_x[at] < end:
                place[n] = base + open_x[at]
                source[n] = at
                n += 1
                at += 1
            next_open[number] = at
            rows[0], rows[1] = min(rows[0], j), max(rows[1], j)
            rows[2], rows[3] = min(rows[2], k), max(rows[3], k)
    return n


@inline_jit
def _put(
    place: NDArray[np.int32],
    n: np.uint64,
    hx: np.float32,
    hy: np.float32,
    hz: np.float32,
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    z: NDArray[np.float32],
) -> None:
    """Coordinates of samples from their places in a brick."""
    to_y, to_z = np.int32(_BITS[0]), np.int32(_BITS[0] + _BITS[1])
    in_x, in_y = np.int32(_BRICK[0] - 1), np.int32(_BRICK[1] - 1)
    for i in range(n):
        p = place[i]
        x[i] = hx * np.float32(np.int32(p & in_x))
        y[i] = hy * np.float32(np.int32((p >> to_y) & in_y))
        z[i] = hz * np.float32(np.int32(p >> to_z))


def _resolve(
    out: NDArray[np.uint8],
    first_layer: int,
    row_start: int,
    row_stop: int,
    open_from: NDArray[np.int64],
    open_x: NDArray[np.int32],
    origin: NDArray[np.float64],
    spacing: NDArray[np.float64],
    pores: NDArray[np.float64],
    pore_reach: float,
    tunnels: NDArray[np.float64],
    tunnel_reach: float,
    levels: NDArray[np.float32],
) -> None:
    """Sum kernels where samples are open, brick by brick; bricks are counted from the first sample of the grid.

    `levels` is one, or one for each open sample in the order of `open_x`.
    """
    nz, _, nx = out.shape
    bx, by, bz = _BRICK
    size = bx * by * bz
    x, y, z, sums = (
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
        np.empty(size, np.float32),
    )
    place, source = np.zeros(size, np.int32), np.zeros(size, np.int64)
    hx, hy, hz = np.float32(spacing[0]), np.float32(spacing[1]), np.float32(spacing[2])
    pore_numbers, tunnel_numbers = np.empty(len(pores) + 1, np.int64), np.empty(len(tunnels) + 1, np.int64)
    pore_list, tunnel_list = np.empty((13, len(pores)), np.float32), np.empty((13, len(tunnels)), np.float32)
    near = np.empty(max(len(pores), len(tunnels)), np.uint8)
    anchor, mid, half, open_rows = np.empty(3), np.empty(3, np.float32), np.empty(3, np.float32), np.empty(4, np.int64)
    u = np.empty(13, np.float32)
    next_open, last_open = np.empty(by * bz, np.int64), np.empty(by * bz, np.int64)
    pore_reach2, tunnel_reach2 = np.float32(pore_reach * pore_reach), np.float32(tunnel_reach * tunnel_reach)
    # a little more, as distances of boxes are rounded in float32
    pore_reach1, tunnel_reach1 = np.float32(pore_reach * 1.0001), np.float32(tunnel_reach * 1.0001)
    each = len(levels) > 1
    row_start0 = row_start - row_start % by
    rows = (row_stop - row_start0 + by - 1) // by
    for brick_z in range(first_layer // bz, (first_layer + nz - 1) // bz + 1):
        k_brick = brick_z * bz - first_layer
        k0, k1 = max(k_brick, 0), min(k_brick + bz, nz)
        low_z = origin[2] + (first_layer + k0) * spacing[2]
        high_z = origin[2] + (first_layer + k1 - 1) * spacing[2]
        anchor[2] = origin[2] + brick_z * bz * spacing[2]
        side = origin[1] + row_start0 * spacing[1], by * spacing[1]
        # kernels sorted by row of bricks: a row then looks at its own instead of all
        pores_from, row_pores = _by_rows(pores, low_z, high_z, *side, rows)
        tunnels_from, row_tunnels = _by_rows(tunnels, low_z, high_z, *side, rows)
        for row in range(rows):
            j0 = row_start0 + row * by
            j1, first_row = min(j0 + by, row_stop), max(j0, row_start)
            anchor[1] = origin[1] + j0 * spacing[1]
            begin, end = nx, 0
            for k in range(k0, k1):
                for j in range(first_row, j1):
                    number = k * (row_stop - row_start) + j - row_start
                    at, last = open_from[number], open_from[number + 1]
                    in_brick = (k - k_brick) * by + j - j0
                    next_open[in_brick], last_open[in_brick] = at, last
                    if at < last:
                        begin, end = min(begin, int(open_x[at])), max(end, int(open_x[last - 1]) + 1)
            in_row, in_layer = (first_row - j0, j1 - j0), (k0 - k_brick, k1 - k_brick)
            listed = listed_from = pores_near = tunnels_near = 0
            for i0 in range(begin // bx * bx, end, bx):
                n = _gather(open_x, next_open, last_open, i0, *in_row, *in_layer, place, source, open_rows)
                if n == 0:
                    continue
                anchor[0] = origin[0] + i0 * spacing[0]
                # kernels near a run of bricks are listed once, as they are the same for most of them
                if i0 >= listed:
                    listed_from, listed = i0, i0 + _LONG * bx
                    ends = anchor[0], origin[0] + (listed - 1) * spacing[0], anchor
                    pores_near = _list(
                        pores, row_pores, pores_from[row], pores_from[row + 1], *ends, pore_numbers, pore_list
                    )
                    tunnels_near = _list(
                        tunnels, row_tunnels, tunnels_from[row], tunnels_from[row + 1], *ends, tunnel_numbers,
                        tunnel_list,
                    )  # fmt: skip
                padded = (n + LANES - 1) // LANES * LANES
                # a copy of the first sample fills the last vector; its sum is not used
                for m in range(n, padded):
                    place[m] = place[0]
                _put(place, np.uint64(padded), hx, hy, hz, x, y, z)
                sums[:padded] = 0
                mid[0], half[0] = hx * np.float32(i0 - listed_from + 0.5 * (bx - 1)), hx * np.float32(0.5 * (bx - 1))
                mid[1] = hy * np.float32(0.5 * (open_rows[0] + open_rows[1]))
                half[1] = hy * np.float32(0.5 * (open_rows[1] - open_rows[0]))
                mid[2] = hz * np.float32(0.5 * (open_rows[2] + open_rows[3]))
                half[2] = hz * np.float32(0.5 * (open_rows[3] - open_rows[2]))
                _near(pore_list, np.uint64(pores_near), mid, half, pore_reach1, near)
                for m in range(pores_near):
                    if near[m]:
                        _seen_from(pores[pore_numbers[m]], anchor, u)
                        _add_balls(x, y, z, np.uint64(padded), u, pore_reach2, sums)
                _near(tunnel_list, np.uint64(tunnels_near), mid, half, tunnel_reach1, near)
                for m in range(tunnels_near):
                    if near[m]:
                        _seen_from(tunnels[tunnel_numbers[m]], anchor, u)
                        add_capsules(x, y, z, np.uint64(padded), u, tunnel_reach2, sums)
                for m in range(n):
                    p = int(place[m])
                    at_y, at_z = j0 + p // bx % by, k_brick + p // (bx * by)
                    out[at_z, at_y, i0 + p % bx] = np.uint8(sums[m] < levels[source[m] if each else 0])


@cache
def resolver(profile: TunnelProfile) -> Callable[..., None]:
    """`_resolve` compiled for one profile, once."""
    add = inline_jit(specialized(add_capsules, profile.name, exponent=inline_jit(profile.exponent)))
    return jit(specialized(_resolve, profile.name, add_capsules=add))
