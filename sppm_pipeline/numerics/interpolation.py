"""Tensor interpolation from a coarse regular grid to the samples of a fine one, by six taps an axis.

Between two samples of the coarse grid a line is taken from the polynomial of degree five through the three samples on
either side (Lagrange). It passes through the coarse samples, and it is continuous. For sums of kernels, which are
smooth but for the axes of tunnels, it is off by an eighth of what the four taps of Catmull and Rom are off by on the
same coarse grid. Taken axis by axis (z, x, y) the 216 taps of a fine sample cost some six multiplications.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

#: Coarse samples that enter along an axis, and how many of them lie before the sample or on it.
TAPS, BEFORE = 6, 3

# Positions are rounded to this fraction of a coarse spacing, far below what a sample resolves: samples whose positions
# differ in the last bits of a float64, because they are counted from another origin, are then equal.
_GRAIN = 2.0**-20

# Rows of coarse samples that are interpolated along x at a time, one a lane; the last two groups are kept.
_LANES = 16
_ROWS = np.uint64(_LANES)
_SHIFT = np.uint64(4)


class Taps(NamedTuple):
    """What the samples along one axis are interpolated from.

    Attributes
    ----------
    first : (m,) int64
        The first of six consecutive coarse samples.
    weights : (m, 6) float32
        Their weights, which add up to one.
    """

    first: NDArray[np.int64]
    weights: NDArray[np.float32]


def taps_at(positions: NDArray[np.float64]) -> Taps:
    """Taps of samples at `positions` (m,), counted in coarse spacings from coarse sample 0."""
    positions = np.rint(positions / _GRAIN) * _GRAIN
    whole = np.floor(positions)
    nodes = np.arange(TAPS) - (BEFORE - 1.0)
    distance = (positions - whole)[:, None] - nodes
    weights = np.empty_like(distance)
    for k in range(TAPS):
        others = np.arange(TAPS) != k
        weights[:, k] = (distance[:, others] / (nodes[k] - nodes[others])).prod(1)
    return Taps(whole.astype(np.int64) - (BEFORE - 1), weights.astype(np.float32))


class Axes(NamedTuple):
    """Taps along x and y as the compiled loops take them, counted from the first coarse sample that is needed.

    Attributes
    ----------
    x_first, x_weights : (nx',) uint64, (6 nx',) float32
        nx' is the number of samples, raised to whole lanes.
    y_first, y_weights : (ny,) int64, (ny, 6) float32
    """

    x_first: NDArray[np.uint64]
    x_weights: NDArray[np.float32]
    y_first: NDArray[np.int64]
    y_weights: NDArray[np.float32]


def axes_of(x: Taps, y: Taps) -> Axes:
    """Taps along x and y for `interpolate_layer`."""
    more = -len(x.first) % _LANES
    return Axes(
        np.pad(x.first - x.first[0], (0, more), mode="edge").astype(np.uint64),
        np.pad(x.weights, ((0, more), (0, 0)), mode="edge").reshape(-1),
        y.first - y.first[0],
        y.weights,
    )


def interpolate_layer(
    planes: Sequence[NDArray[np.float32]],
    weights: NDArray[np.float32],
    axes: Axes,
    level: float,
    rows: range,
    wanted: NDArray[np.int32],
    field: NDArray[np.float32] | None,
    solid: NDArray[np.uint8] | None,
) -> None:
    """Rows of one fine layer: the interpolated values less `level`, or whether they lie below it.

    The value of a sample depends on its taps and the coarse samples alone, to the last bit, whichever rows and parts of
    rows are asked for.

    Parameters
    ----------
    planes : sequence of 6 (cy, cx) float32, C-contiguous
        The coarse samples of the taps along z.
    weights : (6,) float32
        Their weights.
    axes : Axes
        Taps along x and y.
    level : float
    rows : range
        Rows to compute.
    wanted : (ny, 2) int32
        First sample of each row that matters and the one after the last; others are left as they are.
    field, solid : (ny, nx) float32 or uint8, C-contiguous
        One of them receives the result.
    """
    width = planes[0].shape[1]
    p0, p1, p2, p3, p4, p5 = planes
    _interpolate_rows(
        p0,
        p1,
        p2,
        p3,
        p4,
        p5,
        weights,
        *axes,
        np.float32(level),
        rows.start,
        rows.stop,
        wanted,
        np.empty(width, np.float32),
        np.empty(width * _LANES, np.float32),
        np.empty(_LANES * _LANES, np.float32),
        np.empty((2 * _LANES, len(axes.x_first)), np.float32),
        np.empty((1, 1), np.float32) if field is None else field,
        np.empty((1, 1), np.uint8) if solid is None else solid,
        solid is not None,
    )


# Strict arithmetic (no contraction) in what follows: a sample has to come out the same in a vector loop, in its
# remainder, and whether its value is stored or compared. Unsigned indices let the compiler make vector loops.


@jit
def _sum_rows(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    f: NDArray[np.float32],
    w: NDArray[np.float32],
    less: np.float32,
    out: NDArray[np.float32],
    start: np.uint64,
    stop: np.uint64,
) -> None:
    """Weighted sum of six rows less a number."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(start, stop):
        out[i] = ((w0 * a[i] + w1 * b[i]) + (w2 * c[i] + w3 * d[i])) + (w4 * e[i] + w5 * f[i]) - less


@jit
def _compare_rows(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    f: NDArray[np.float32],
    w: NDArray[np.float32],
    level: np.float32,
    out: NDArray[np.uint8],
    start: np.uint64,
    stop: np.uint64,
) -> None:
    """Whether the weighted sum of six rows lies below a number."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(start, stop):
        out[i] = np.uint8(((w0 * a[i] + w1 * b[i]) + (w2 * c[i] + w3 * d[i])) + (w4 * e[i] + w5 * f[i]) < level)


@jit
def _into_lane(
    row: NDArray[np.float32], lanes: NDArray[np.float32], lane: np.uint64, a: np.uint64, b: np.uint64
) -> None:
    for i in range(a, b):
        lanes[(i << _SHIFT) + lane] = row[i]


@jit
def _along_x(
    lanes: NDArray[np.float32],
    k: np.uint64,
    w: NDArray[np.float32],
    i: np.uint64,
    tile: NDArray[np.float32],
    to: np.uint64,
) -> None:
    """One fine sample of sixteen rows: the weighted sum of six columns of the lanes, from element k on."""
    w0, w1, w2 = w[i], w[i + np.uint64(1)], w[i + np.uint64(2)]
    w3, w4, w5 = w[i + np.uint64(3)], w[i + np.uint64(4)], w[i + np.uint64(5)]
    for r in range(_ROWS):
        tile[to + r] = (
            (w0 * lanes[k + r] + w1 * lanes[k + r + np.uint64(16)])
            + (w2 * lanes[k + r + np.uint64(32)] + w3 * lanes[k + r + np.uint64(48)])
        ) + (w4 * lanes[k + r + np.uint64(64)] + w5 * lanes[k + r + np.uint64(80)])


@jit
def _out_of_lanes(tile: NDArray[np.float32], rows: NDArray[np.float32], slot: np.uint64, x: np.uint64) -> None:
    for r in range(_ROWS):
        row = rows[slot + r]
        for i in range(_ROWS):
            row[x + i] = tile[(i << _SHIFT) + r]


@jit
def _interpolate_rows(
    p0: NDArray[np.float32],
    p1: NDArray[np.float32],
    p2: NDArray[np.float32],
    p3: NDArray[np.float32],
    p4: NDArray[np.float32],
    p5: NDArray[np.float32],
    weights: NDArray[np.float32],
    x_first: NDArray[np.uint64],
    x_weights: NDArray[np.float32],
    y_first: NDArray[np.int64],
    y_weights: NDArray[np.float32],
    level: np.float32,
    row_start: int,
    row_stop: int,
    wanted: NDArray[np.int32],
    coarse: NDArray[np.float32],
    lanes: NDArray[np.float32],
    tile: NDArray[np.float32],
    rows: NDArray[np.float32],
    field: NDArray[np.float32],
    solid: NDArray[np.uint8],
    threshold: bool,
) -> None:
    """Row after row; coarse row j, interpolated along z and x, stands in ``rows[j % 32]``."""
    held0, held1 = -1, -1
    for y in range(row_start, row_stop):
        if wanted[y, 0] >= wanted[y, 1]:
            continue
        j = y_first[y]
        for group in range(j // 16, (j + 5) // 16 + 1):
            if (held0 if group % 2 == 0 else held1) == group:
                continue
            if group % 2 == 0:
                held0 = group
            else:
                held1 = group
            # what this and the following rows want of the group
            start, stop = wanted[y, 0], wanted[y, 1]
            later = y + 1
            while later < row_stop and y_first[later] < 16 * (group + 1):
                if wanted[later, 0] < wanted[later, 1]:
                    start, stop = min(start, wanted[later, 0]), max(stop, wanted[later, 1])
                later += 1
            a, b = x_first[start // 16 * 16], x_first[(stop - 1) | 15] + np.uint64(6)
            for r in range(min(16, p0.shape[0] - 16 * group)):
                k = 16 * group + r
                _sum_rows(p0[k], p1[k], p2[k], p3[k], p4[k], p5[k], weights, np.float32(0), coarse, a, b)
                _into_lane(coarse, lanes, np.uint64(r), a, b)
            slot = np.uint64(16 * (group % 2))
            for x in range(np.uint64(start // 16 * 16), np.uint64(stop), _ROWS):
                for i in range(_ROWS):
                    sample = x + i
                    _along_x(lanes, x_first[sample] << _SHIFT, x_weights, sample * np.uint64(6), tile, i << _SHIFT)
                _out_of_lanes(tile, rows, slot, np.uint64(x))
        six = (rows[j % 32], rows[(j + 1) % 32], rows[(j + 2) % 32])
        more = (rows[(j + 3) % 32], rows[(j + 4) % 32], rows[(j + 5) % 32])
        start, stop = wanted[y, 0], wanted[y, 1]
        if threshold:
            _compare_rows(*six, *more, y_weights[y], level, solid[y], np.uint64(start), np.uint64(stop))
        else:
            _sum_rows(*six, *more, y_weights[y], level, field[y], np.uint64(start), np.uint64(stop))
