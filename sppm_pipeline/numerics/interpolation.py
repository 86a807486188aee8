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

#: Fine samples of a block of a row.
BLOCK = 16
_BLOCK = np.uint64(BLOCK)

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


class Band(NamedTuple):
    """Weights for `stretch`: each block of fine samples from the coarse ones that any of them is interpolated from.

    Attributes
    ----------
    first : (blocks, parts) uint64
        The first of six consecutive coarse samples, counted from the first of all.
    weights : (blocks, parts, 6, BLOCK) float32
        Their weights, zero for those that are no taps of a sample.
    """

    first: NDArray[np.uint64]
    weights: NDArray[np.float32]


def band_of(taps: Taps) -> Band:
    """The weights of `taps` block by block; the last sample is repeated to fill the last block."""
    more = -len(taps.first) % BLOCK
    first = np.pad(taps.first - taps.first[0], (0, more), mode="edge").reshape(-1, BLOCK)
    weights = np.pad(taps.weights, ((0, more), (0, 0)), mode="edge").reshape(-1, BLOCK, TAPS)
    parts = -(-int((first[:, -1] - first[:, 0]).max() + TAPS) // TAPS)
    place = first[:, :1] + TAPS * np.arange(parts)
    # parts beyond the last coarse sample overlap the one before; what that has counted is not counted again
    start = np.minimum(place, first[-1, -1])
    column = start[:, :, None] + np.arange(TAPS)
    tap = column[:, :, :, None] - first[:, None, None, :]
    found = np.take_along_axis(weights.transpose(0, 2, 1)[:, None], np.clip(tap, 0, TAPS - 1), axis=2)
    counts = (tap >= 0) & (tap < TAPS) & (column >= place[:, :, None])[..., None]
    return Band(start.astype(np.uint64), np.where(counts, found, np.float32(0)))


def stretch(coarse: NDArray[np.float32], band: Band, rows: range, out: NDArray[np.float32]) -> None:
    """Interpolate rows of coarse planes along x.

    Parameters
    ----------
    coarse : (n, cy, cx) float32, C-contiguous
        Planes; column 0 is the first coarse sample of the first tap.
    band : Band
        Of the fine samples along x.
    rows : range
        Rows to stretch.
    out : (n, cy, nx') float32, C-contiguous
        Receives as many samples as there are in all blocks.
    """
    parts = np.uint64(band.first.shape[1])
    _stretch(coarse, band.first.reshape(-1), parts, band.weights.reshape(-1), rows.start, rows.stop, out)


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


@fused_jit
def _add_block(
    coarse: NDArray[np.float32],
    k: np.uint64,
    w: NDArray[np.float32],
    j: np.uint64,
    out: NDArray[np.float32],
    x: np.uint64,
) -> None:
    """Add six coarse samples, from k on, to a block of fine ones, each with its own weights."""
    a, b, c = coarse[k], coarse[k + np.uint64(1)], coarse[k + np.uint64(2)]
    d, e, f = coarse[k + np.uint64(3)], coarse[k + np.uint64(4)], coarse[k + np.uint64(5)]
    for i in range(_BLOCK):
        out[x + i] = (
            out[x + i]
            + a * w[j + i]
            + b * w[j + i + _BLOCK]
            + c * w[j + i + np.uint64(2) * _BLOCK]
            + d * w[j + i + np.uint64(3) * _BLOCK]
            + e * w[j + i + np.uint64(4) * _BLOCK]
            + f * w[j + i + np.uint64(5) * _BLOCK]
        )


@jit
def _stretch(
    coarse: NDArray[np.float32],
    first: NDArray[np.uint64],
    parts: np.uint64,
    weights: NDArray[np.float32],
    row_start: int,
    row_stop: int,
    out: NDArray[np.float32],
) -> None:
    """Row after row, block after block; coarse samples that are no taps add zero, which changes no sum."""
    blocks, step = np.uint64(len(first)) // parts, np.uint64(TAPS * BLOCK)
    for plane in range(coarse.shape[0]):
        for row in range(row_start, row_stop):
            source, target = coarse[plane, row], out[plane, row]
            target[:] = np.float32(0)
            for block in range(blocks):
                for number in range(block * parts, (block + np.uint64(1)) * parts):
                    _add_block(source, first[number], weights, number * step, target, block * _BLOCK)


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
