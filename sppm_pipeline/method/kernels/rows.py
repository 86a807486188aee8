"""Inner loops of the kernel sum: rows of samples along x, sixteen samples (or sixteen rows) at a time.

The loops have a constant length, unsigned indices and a polynomial exponential: only so does the compiler turn them
into vector instructions without a scalar remainder (0.3 ns a sample for a tunnel; a call of the C library's
exponential alone takes 2 ns). All lengths are scaled by the caller so that a kernel is ``2^-(r^power)``.

Rows are prepared in groups of sixteen: `point_rows` and `tunnel_rows` write into a small table what the sample loops
need to know of each row. The table has `LANES` columns; integers in it are kept by the bits of a float32.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sppm_pipeline.method.kernels.profiles import TunnelProfile
from sppm_pipeline.services.arrays import F32, I32
from sppm_pipeline.services.jit.compiled import inline_jit, jit, specialized

#: Samples of one block, rows of one group.
LANES = 16
_LANES = np.uint64(LANES)
_SHIFT = np.uint64(4)

# Rows of the table: first sample, the first block that is wanted and the one after the last, as integers, then three
# numbers of the kernel.
FIRST, _BEGIN, _END, ACROSS, ALONG, REST = (np.uint64(LANES * row) for row in range(6))
_FACTOR = ACROSS
# Then the first and the last sample of the row that is wanted.
_WANTED_FROM, _WANTED_TO = np.uint64(6 * LANES), np.uint64(7 * LANES)
#: Length of the table of a group of rows.
TABLE = 8 * LANES

# 2^-f = sum of _Pi f^i on 0 <= f <= 1: least relative error at Chebyshev points, 8e-8 before rounding.
_P0 = np.float32(0.99999992321)
_P1 = np.float32(-0.69314217109)
_P2 = np.float32(0.24017158846)
_P3 = np.float32(-0.05527813502)
_P4 = np.float32(0.00918687438)
_P5 = np.float32(-0.00093811647)

# Beyond 2^-125 the integer trick below would leave the normal numbers. Samples of a block may lie far outside the
# reach of a kernel on a coarse grid.
_LAST = np.float32(125.0)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
# Stands for "no chord"; far outside of any grid, and still an integral number of samples.
_FAR = np.float32(1e12)


@inline_jit
def exp2_minus(r: np.float32) -> np.float32:
    """2^-r for r >= 0, relative error below 3e-7; the exponent is subtracted from the bits of the mantissa."""
    r = min(r, _LAST)
    whole = np.int32(r)
    # 2^-r is 2^-f, a polynomial, with the whole part subtracted from the exponent's bits
    f = r - np.float32(whole)
    p = ((((_P5 * f + _P4) * f + _P3) * f + _P2) * f + _P1) * f + _P0
    return np.int32(np.float32(p).view(np.int32) - np.int32(whole << np.int32(23))).view(np.float32)


def exponent(squared_distance: np.float32) -> np.float32:
    """Stands for the exponent of a tunnel profile in the loops that are compiled for each profile."""
    raise NotImplementedError


@inline_jit
def fill_gauss(row: F32, blocks: int, first: np.float32, step: np.float32) -> None:
    """row[i] = 2^-((first + i step)^2) for the first `blocks` blocks of the row."""
    for i in range(np.uint64(blocks) << _SHIFT):
        x = first + step * np.float32(np.int32(i))
        row[i] = exp2_minus(x * x)


@inline_jit
def clip_rows(table: F32, low: np.float32, high: np.float32, nx: np.float32, i: int) -> np.float32:
    """Write first sample and blocks of row i; they cover at least low <= x <= high where it is wanted.

    Returns the first sample.

    Where a block begins depends on `low`, `high` and `nx` alone, so that a sample is the same whatever is wanted.
    """
    lanes, inverse = np.float32(LANES), np.float32(1.0 / LANES)
    first = max(np.float32(np.ceil(low)), _ZERO)
    # an empty chord has high < low, and so no blocks
    last = min(np.float32(np.floor(high)), nx - _ONE)
    blocks = np.float32(np.floor((last - first) * inverse)) + _ONE
    blocks = blocks if last >= first else _ZERO
    # A row that would run over the end starts earlier instead.
    first = max(min(first, nx - blocks * lanes), _ZERO)
    begin = max(np.float32(np.floor((table[_WANTED_FROM + i] - first) * inverse)), _ZERO)
    end = min(np.float32(np.floor((table[_WANTED_TO + i] - first) * inverse)) + _ONE, blocks)
    table[FIRST + i] = np.int32(first).view(np.float32)
    table[_BEGIN + i] = np.int32(begin).view(np.float32)
    table[_END + i] = np.int32(max(begin, end)).view(np.float32)
    return first


@inline_jit
def want_rows(table: F32, first_wanted: I32, last_wanted: I32, row: int) -> bool:
    """Write the first and the last sample that is wanted of sixteen rows from `row` on; False if there are none."""
    some, start = np.int32(0), np.uint64(row)
    for i in range(_LANES):
        begin, end = first_wanted[start + i], last_wanted[start + i]
        table[_WANTED_FROM + i], table[_WANTED_TO + i] = np.float32(begin), np.float32(end)
        some += np.int32(begin <= end)
    return bool(some > np.int32(0))


@inline_jit
def point_rows(
    table: F32,
    reach: np.float32,
    dy: np.float32,
    step: np.float32,
    dz: np.float32,
    center: np.float32,
    inverse: np.float32,
    nx: np.float32,
) -> None:
    """Prepare sixteen rows through the ball of a pore.

    Row i passes the center at ``dy + i step``, `dz`; the center lies at `center` samples; `inverse` turns scaled
    lengths into samples.
    """
    for i in range(_LANES):
        y = dy + step * np.float32(np.int32(i))
        aside2 = y * y + dz * dz
        # Pythagoras: half the chord that the row cuts out of the ball of reach
        chord2 = reach * reach - aside2
        chord = np.float32(math.sqrt(max(chord2, _ZERO))) * inverse
        clip_rows(table, center - chord, center + chord if chord2 >= _ZERO else -_FAR, nx, i)
        table[_FACTOR + i] = exp2_minus(aside2)


@inline_jit
def _whole(bits: np.float32) -> np.uint64:
    """An integer of the table, which is not negative."""
    return np.uint64(np.float32(bits).view(np.uint32))


@inline_jit
def add_gauss_rows(out: F32, start: int, stride: int, rows: int, table: F32, values: F32, shift: int) -> None:
    """Add ``factor * values`` to the prepared rows; sample x of a row takes ``values[x + shift]``.

    Row i of the group begins at ``out[start + i stride]``.
    """
    for row in range(np.uint64(rows)):
        factor = table[_FACTOR + row]
        first = _whole(table[FIRST + row])
        target = np.uint64(start + np.int64(row) * stride) + first
        source = first + np.uint64(shift)
        for i in range(_whole(table[_BEGIN + row]) << _SHIFT, _whole(table[_END + row]) << _SHIFT):
            out[target + i] += factor * values[source + i]


@inline_jit
def tunnel_rows(
    table: F32,
    reach: np.float32,
    dy: np.float32,
    step: np.float32,
    dz: np.float32,
    axis: F32,
    start: np.float32,
    first: np.float32,
    step_x: np.float32,
    inverse: np.float32,
    nx: np.float32,
) -> None:
    """Prepare sixteen rows through the capsule of a tunnel, and write them to `table` (TABLE,).

    In the plane spanned by x and the segment a row is the line at a constant offset t; `across` and `along` are the
    coordinates of its first sample in the frame of the segment, `rest` is the squared distance of the row from that
    plane. `reach` is the radius of the capsule; row i has the offset ``dy + i step``, `dz` from the start of the
    segment. `axis` is ux, ua, 1/ua, ny, nz, slanted, length: the direction of the segment along x and across it, ``ua =
    sqrt(uy^2 + uz^2)``, the unit vector (ny, nz) = (uy, uz) / ua, and 1 where 1/ua is usable (the segment is not
    parallel to x). Sample `start`, an integer, lies at `first` from the start of the segment; `inverse` is that of
    `step_x`, and a row has `nx` samples.
    """
    ux = axis[0]
    ua = axis[1]
    over_ua = axis[2]
    ny = axis[3]
    nz = axis[4]
    slanted = axis[5] > _ZERO
    length = axis[6]
    for i in range(_LANES):
        y = dy + step * np.float32(np.int32(i))
        # the row's offset in the plane of x and the segment, and out of this plane
        t = y * ny + dz * nz
        w = dz * ny - y * nz
        rest = w * w
        radius2 = reach * reach - rest
        # The capsule is the hull of two balls and a cylinder; each cuts the row in an interval, perhaps empty.
        near2 = radius2 - t * t
        t_end = t - ua * length
        end2 = radius2 - t_end * t_end
        near = np.float32(math.sqrt(max(near2, _ZERO)))
        end = np.float32(math.sqrt(max(end2, _ZERO)))
        radius = np.float32(math.sqrt(max(radius2, _ZERO)))
        low = min(-near if near2 >= _ZERO else _FAR, ux * length - end if end2 >= _ZERO else _FAR)
        high = max(near if near2 >= _ZERO else -_FAR, ux * length + end if end2 >= _ZERO else -_FAR)
        cylinder = slanted & (radius2 >= _ZERO)
        # where the row enters and leaves the cylinder, as places along the segment
        left = (t - radius * ux) * over_ua
        right = (t + radius * ux) * over_ua
        has_left = cylinder & (left >= _ZERO) & (left <= length)
        has_right = cylinder & (right >= _ZERO) & (right <= length)
        low = min(low, (t * ux - radius) * over_ua if has_left else _FAR)
        high = max(high, (t * ux + radius) * over_ua if has_right else -_FAR)
        begin = clip_rows(table, start + (low - first) * inverse, start + (high - first) * inverse, nx, i)
        x = first + (begin - start) * step_x
        table[ACROSS + i] = ua * x - ux * t
        table[ALONG + i] = ux * x + ua * t
        table[REST + i] = rest


def add_tunnel_rows(out: F32, start: int, stride: int, rows: int, table: F32, axis: F32, step: np.float32) -> None:
    """Add ``2^-exponent(d^2)`` to the prepared rows; d is the distance from the segment, `step` the spacing along x.

    Row i of the group begins at ``out[start + i stride]``. Compiled once for each tunnel profile by `compiled_for`.
    """
    across_step = axis[1] * step
    along_step = axis[0] * step
    length = axis[6]
    for row in range(np.uint64(rows)):
        target = np.uint64(start + np.int64(row) * stride) + _whole(table[FIRST + row])
        across = table[ACROSS + row]
        along = table[ALONG + row]
        rest = table[REST + row]
        for i in range(_whole(table[_BEGIN + row]) << _SHIFT, _whole(table[_END + row]) << _SHIFT):
            x = np.float32(np.int32(i))
            v = across + across_step * x
            s = along + along_step * x
            # 0 beside the segment, else the way past its nearer end
            beyond = s - min(max(s, _ZERO), length)
            out[target + i] += exp2_minus(exponent(np.float32(v * v + rest + beyond * beyond)))


def compiled_for(profile: TunnelProfile, add: Callable[..., None]) -> Callable[..., None]:
    """A function that calls `add_tunnel_rows`, compiled for one profile: its exponent is inlined into the inner loop.

    A function that is handed to a compiled one would be called through a pointer for every sample, or be compiled
    again in every process; copies under names of their own are neither, and Numba keeps them on disk.
    """
    add_rows = inline_jit(specialized(add_tunnel_rows, profile.name, exponent=inline_jit(profile.exponent)))
    return jit(specialized(add, profile.name, add_tunnel_rows=add_rows))
