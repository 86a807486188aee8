"""Tensor interpolation from a coarse regular grid to the samples of a fine one, by six taps an axis.

Between two samples of the coarse grid a line is taken from the polynomial of degree five through the three samples on
either side (Lagrange). It passes through the coarse samples, and it is continuous. For sums of kernels, which are
smooth but for the axes of tunnels, it is off by a fifth to an eighth of what the four taps of Catmull and Rom are off
by on the same coarse grid. Taken axis by axis (x, z, y) the 216 taps of a fine sample cost some eight multiplications:
`stretch` makes the rows of coarse planes fine, once for all layers near them, and `interpolate_layer` does the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import fused_jit, jit

#: Coarse samples that enter along an axis, and how many of them lie before the sample or on it.
TAPS, BEFORE = 6, 3

# Positions are rounded to this fraction of a coarse spacing, far below what a sample resolves: samples whose positions
# differ in the last bits of a float64, because they are counted from another origin, are then equal.
_GRAIN = 2.0**-20

#: Rows that are stretched at a time, one a lane, and samples of a block of a row.
LANES = 16
_LANES = np.uint64(LANES)
_SHIFT = np.uint64(4)

# Coarse rows of a layer that are kept while the rows between them are computed: at least as many as there are taps.
_KEPT = 8


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


def whole_lanes(taps: Taps) -> Taps:
    """Taps for `stretch`: counted from the first coarse sample, the last one repeated to fill the lanes."""
    more = -len(taps.first) % LANES
    return Taps(
        np.pad(taps.first - taps.first[0], (0, more), mode="edge"),
        np.pad(taps.weights, ((0, more), (0, 0)), mode="edge"),
    )


def stretch(coarse: NDArray[np.float32], taps: Taps, rows: range, out: NDArray[np.float32]) -> None:
    """Interpolate rows of coarse planes along x.

    Parameters
    ----------
    coarse : (n, cy, cx) float32, C-contiguous
        Planes; column 0 is the first coarse sample of the first tap.
    taps : Taps
        Of the fine samples along x, as `whole_lanes` makes them.
    rows : range
        Rows to stretch.
    out : (n, cy, nx') float32, C-contiguous
        Receives as many samples as there are taps.
    """
    lanes, tile = np.empty(coarse.shape[2] * LANES, np.float32), np.empty(LANES * LANES, np.float32)
    first = taps.first.astype(np.uint64)
    _stretch(coarse, first, taps.weights.reshape(-1), rows.start, rows.stop, lanes, tile, out)


def interpolate_layer(
    planes: Sequence[NDArray[np.float32]],
    weights: NDArray[np.float32],
    taps: Taps,
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
    planes : sequence of 6 (cy, nx') float32, C-contiguous
        The coarse planes of the taps along z, stretched along x; row 0 is the first coarse sample of the first tap.
    weights : (6,) float32
        Weights of the planes.
    taps : Taps
        Of the ny fine samples along y.
    level : float
    rows : range
        Rows to compute.
    wanted : (ny, 2) int32
        First sample of each row that matters and the one after the last; others are left as they are.
    field, solid : (ny, nx) float32 or uint8, C-contiguous
        One of them receives the result.
    """
    p0, p1, p2, p3, p4, p5 = planes
    _interpolate_rows(
        p0,
        p1,
        p2,
        p3,
        p4,
        p5,
        weights,
        taps.first - taps.first[0],
        taps.weights,
        np.float32(level),
        rows.start,
        rows.stop,
        wanted,
        np.empty((_KEPT, p0.shape[1]), np.float32),
        np.empty((1, 1), np.float32) if field is None else field,
        np.empty((1, 1), np.uint8) if solid is None else solid,
        solid is not None,
    )


# In what follows every sum is a chain that begins with a number, so that it comes out the same wherever it is taken
# (see `fused_jit`). Unsigned indices let the compiler make vector loops.


@fused_jit
def _sum_rows(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    f: NDArray[np.float32],
    w: NDArray[np.float32],
    begin: np.float32,
    out: NDArray[np.float32],
    start: np.uint64,
    stop: np.uint64,
) -> None:
    """A number and the weighted sum of six rows."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(start, stop):
        out[i] = begin + w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i] + w5 * f[i]


@fused_jit
def _negative_rows(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    e: NDArray[np.float32],
    f: NDArray[np.float32],
    w: NDArray[np.float32],
    begin: np.float32,
    out: NDArray[np.uint8],
    start: np.uint64,
    stop: np.uint64,
) -> None:
    """Whether a number and the weighted sum of six rows are negative."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(start, stop):
        value = begin + w0 * a[i] + w1 * b[i] + w2 * c[i] + w3 * d[i] + w4 * e[i] + w5 * f[i]
        out[i] = np.uint8(value < np.float32(0))


@jit
def _into_lane(
    row: NDArray[np.float32], lanes: NDArray[np.float32], lane: np.uint64, a: np.uint64, b: np.uint64
) -> None:
    for i in range(a, b):
        lanes[(i << _SHIFT) + lane] = row[i]


@fused_jit
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
    for r in range(_LANES):
        tile[to + r] = (
            np.float32(0)
            + w0 * lanes[k + r]
            + w1 * lanes[k + r + np.uint64(16)]
            + w2 * lanes[k + r + np.uint64(32)]
            + w3 * lanes[k + r + np.uint64(48)]
            + w4 * lanes[k + r + np.uint64(64)]
            + w5 * lanes[k + r + np.uint64(80)]
        )


@jit
def _out_of_lanes(
    tile: NDArray[np.float32], rows: NDArray[np.float32], row: np.uint64, count: np.uint64, x: np.uint64
) -> None:
    for r in range(count):
        target = rows[row + r]
        for i in range(_LANES):
            target[x + i] = tile[(i << _SHIFT) + r]


@jit
def _stretch(
    coarse: NDArray[np.float32],
    x_first: NDArray[np.uint64],
    x_weights: NDArray[np.float32],
    row_start: int,
    row_stop: int,
    lanes: NDArray[np.float32],
    tile: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Sixteen rows at a time: into lanes, along x, and back into rows."""
    width, end = np.uint64(coarse.shape[2]), np.uint64(len(x_first))
    for plane in range(coarse.shape[0]):
        for row in range(row_start, row_stop, 16):
            count = np.uint64(min(16, row_stop - row))
            for r in range(count):
                _into_lane(coarse[plane, np.uint64(row) + np.uint64(r)], lanes, np.uint64(r), np.uint64(0), width)
            for x in range(np.uint64(0), end, _LANES):
                for i in range(_LANES):
                    sample = x + i
                    _along_x(lanes, x_first[sample] << _SHIFT, x_weights, sample * np.uint64(6), tile, i << _SHIFT)
                _out_of_lanes(tile, out[plane], np.uint64(row), count, np.uint64(x))


@jit
def _interpolate_rows(
    p0: NDArray[np.float32],
    p1: NDArray[np.float32],
    p2: NDArray[np.float32],
    p3: NDArray[np.float32],
    p4: NDArray[np.float32],
    p5: NDArray[np.float32],
    weights: NDArray[np.float32],
    y_first: NDArray[np.int64],
    y_weights: NDArray[np.float32],
    level: np.float32,
    row_start: int,
    row_stop: int,
    wanted: NDArray[np.int32],
    kept: NDArray[np.float32],
    field: NDArray[np.float32],
    solid: NDArray[np.uint8],
    threshold: bool,
) -> None:
    """Row after row; coarse row j, interpolated along z, stands in ``kept[j % 8]``, where it was wanted so far."""
    held = np.full(8, -1, np.int64)
    low = np.zeros(8, np.int64)
    high = np.zeros(8, np.int64)
    for y in range(row_start, row_stop):
        start, stop = np.int64(wanted[y, 0]), np.int64(wanted[y, 1])
        if start >= stop:
            continue
        first = y_first[y]
        for j in range(first, first + 6):
            slot = j % 8
            if held[slot] != j:
                held[slot] = j
                low[slot] = high[slot] = start
            for side in range(2):
                a = np.uint64(start if side == 0 else high[slot])
                b = np.uint64(low[slot] if side == 0 else stop)
                if a < b:
                    six = (p0[j], p1[j], p2[j], p3[j], p4[j], p5[j])
                    _sum_rows(*six, weights, np.float32(0), kept[slot], a, b)
            low[slot], high[slot] = min(low[slot], start), max(high[slot], stop)
        near = (kept[first % 8], kept[(first + 1) % 8], kept[(first + 2) % 8])
        far = (kept[(first + 3) % 8], kept[(first + 4) % 8], kept[(first + 5) % 8])
        if threshold:
            _negative_rows(*near, *far, y_weights[y], -level, solid[y], np.uint64(start), np.uint64(stop))
        else:
            _sum_rows(*near, *far, y_weights[y], -level, field[y], np.uint64(start), np.uint64(stop))
