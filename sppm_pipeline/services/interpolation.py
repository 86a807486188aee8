"""Tensor interpolation from a coarse regular grid to the samples of a fine one, by six taps an axis.

Between two samples of the coarse grid a line is taken from the polynomial of degree five through the three samples on
either side (Lagrange). It passes through the coarse samples, and it is continuous. For sums of kernels, which are
smooth but for the axes of tunnels, it is off by a fifth to an eighth of what the four taps of Catmull and Rom are off
by on the same coarse grid. Taken axis by axis (x, z, y) the 216 taps of a fine sample cost some eight multiplications:
`stretch` makes the rows of coarse planes fine, once for all layers near them, and `interpolate_layers` does the rest.

Bounds that decide runs of samples at once do not pay. Taken from the least and largest of the six coarse rows and the
weights' overshoot, they decide half of the blocks of sixteen samples where pixels are a quarter of the coarse spacing,
a tenth where they are three quarters; but to look through six rows takes as long as to add them up.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sppm_pipeline.services.arrays import F32, F64, I32, I64, U8, U64
from sppm_pipeline.services.jit.compiled import fused_jit, jit

#: Coarse samples that enter along an axis, and how many of them lie before the sample or on it.
TAPS, BEFORE = 6, 3

# Positions are rounded to this fraction of a coarse spacing, far below what a sample resolves: samples whose positions
# differ in the last bits of a float64, because they are counted from another origin, are then equal.
_GRAIN = 2.0**-20

#: Fine samples of a block of a row.
BLOCK = 16
_BLOCK = np.uint64(BLOCK)


class Taps(NamedTuple):
    """Coarse samples and weights from which those along one axis are interpolated."""

    first: I64  # (m,), the first of six consecutive coarse samples
    weights: F32  # (m, 6); they add up to one


def taps_at(positions: F64) -> Taps:
    """Taps of samples at `positions` (m,), counted in coarse spacings from coarse sample 0."""
    positions = np.rint(positions / _GRAIN) * _GRAIN
    whole = np.floor(positions)
    nodes = np.arange(TAPS) - (BEFORE - 1.0)
    distance = (positions - whole)[:, None] - nodes
    # Lagrange's polynomials of the six nodes
    weights = np.empty_like(distance)
    for k in range(TAPS):
        others = np.arange(TAPS) != k
        weights[:, k] = (distance[:, others] / (nodes[k] - nodes[others])).prod(1)
    return Taps(whole.astype(np.int64) - (BEFORE - 1), weights.astype(np.float32))


class Band(NamedTuple):
    """Weights for `stretch`: each block of fine samples from the coarse ones that any of them is interpolated from."""

    # (blocks, parts), the first of six consecutive coarse samples, counted from the first of all
    first: U64
    weights: F32  # (blocks, parts, 6, BLOCK), zero for those that are no taps of a sample


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


def stretch(coarse: F32, band: Band, wanted: I32, out: F32) -> None:
    """Interpolate rows of a coarse plane (cy, cx), column 0 for the first tap, along x into `out` (cy, nx').

    `out` has as many samples as there are in all blocks. `wanted` (cy, 2) is the first block of each row that matters,
    and the one after the last; others are left as they are.
    """
    _stretch(coarse, band.first.reshape(-1), np.uint64(band.first.shape[1]), band.weights.reshape(-1), wanted, out)


def interpolate_layers(
    planes: F32,
    first: I64,
    weights: F32,
    taps: Taps,
    level: float,
    rows: range,
    wanted: I32,
    field: F32 | None,
    solid: U8 | None,
) -> None:
    """Rows of fine layers: the interpolated values less `level`, or whether they lie below it.

    The value of a sample depends on its taps and the coarse samples alone, to the last bit, whichever rows and parts of
    rows are asked for.

    `planes` (n, cy, nx') are coarse planes, stretched along x, plane k at k modulo n; row 0 is the first coarse sample
    of the first tap along y. `first` and `weights` are the taps of the layers along z, `taps` those of the fine samples
    along y. `wanted` (layers, ny, 2) is the first sample of each row that matters and the one after the last; others
    are left as they are. `field` or `solid` (layers, ny, nx) receives the result.
    """
    coarse = int(taps.first[rows.stop - 1] - taps.first[rows.start]) + TAPS
    _interpolate_rows(
        planes,
        first,
        weights,
        taps.first - taps.first[0],
        taps.weights,
        np.float32(level),
        rows.start,
        rows.stop,
        wanted,
        np.empty((coarse, planes.shape[2]), np.float32),
        np.empty((1, 1, 1), np.float32) if field is None else field,
        np.empty((1, 1, 1), np.uint8) if solid is None else solid,
        solid is not None,
    )


# In what follows every sum is a chain that begins with a number, so that it comes out the same wherever it is taken
# (see `fused_jit`). Unsigned indices let the compiler make vector loops.


@fused_jit
def _between_planes(
    p0: F32,
    p1: F32,
    p2: F32,
    p3: F32,
    p4: F32,
    p5: F32,
    row: np.uint64,
    w: F32,
    out: F32,
    to: np.uint64,
    start: np.uint64,
    stop: np.uint64,
) -> None:
    """The weighted sum of one row of six planes."""
    w0, w1, w2, w3, w4, w5 = w[0], w[1], w[2], w[3], w[4], w[5]
    for i in range(start, stop):
        near = np.float32(0) + w0 * p0[row, i] + w1 * p1[row, i] + w2 * p2[row, i]
        out[to, i] = near + w3 * p3[row, i] + w4 * p4[row, i] + w5 * p5[row, i]


@fused_jit
def _between_rows(
    rows: F32, k: np.uint64, w: F32, y: np.uint64, begin: np.float32, out: F32, start: np.uint64, stop: np.uint64
) -> None:
    """A number and the weighted sum of six rows from row k on, with the weights of fine row y."""
    k1, k2, k3, k4, k5 = k + np.uint64(1), k + np.uint64(2), k + np.uint64(3), k + np.uint64(4), k + np.uint64(5)
    w0, w1, w2, w3, w4, w5 = w[y, 0], w[y, 1], w[y, 2], w[y, 3], w[y, 4], w[y, 5]
    for i in range(start, stop):
        near = begin + w0 * rows[k, i] + w1 * rows[k1, i] + w2 * rows[k2, i]
        out[y, i] = near + w3 * rows[k3, i] + w4 * rows[k4, i] + w5 * rows[k5, i]


@fused_jit
def _negative_between_rows(
    rows: F32, k: np.uint64, w: F32, y: np.uint64, begin: np.float32, out: U8, start: np.uint64, stop: np.uint64
) -> None:
    """Signs of the values of `_between_rows`: True where negative."""
    k1, k2, k3, k4, k5 = k + np.uint64(1), k + np.uint64(2), k + np.uint64(3), k + np.uint64(4), k + np.uint64(5)
    w0, w1, w2, w3, w4, w5 = w[y, 0], w[y, 1], w[y, 2], w[y, 3], w[y, 4], w[y, 5]
    for i in range(start, stop):
        near = begin + w0 * rows[k, i] + w1 * rows[k1, i] + w2 * rows[k2, i]
        value = near + w3 * rows[k3, i] + w4 * rows[k4, i] + w5 * rows[k5, i]
        out[y, i] = np.uint8(value < np.float32(0))


@fused_jit
def _stretch(coarse: F32, first: U64, parts: np.uint64, weights: F32, wanted: I32, out: F32) -> None:
    """Row after row, block after block; coarse samples that are no taps add zero, which changes no sum."""
    step = np.uint64(TAPS * BLOCK)
    one, two, three, four, five = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(5)
    for row in range(np.uint64(coarse.shape[0])):
        for block in range(np.uint64(wanted[row, 0]), np.uint64(max(wanted[row, 0], wanted[row, 1]))):
            x = block * _BLOCK
            for i in range(_BLOCK):
                out[row, x + i] = np.float32(0)
            for number in range(block * parts, (block + one) * parts):
                k, j = first[number], number * step
                a, b, c = coarse[row, k], coarse[row, k + one], coarse[row, k + two]
                d, e, f = coarse[row, k + three], coarse[row, k + four], coarse[row, k + five]
                for i in range(_BLOCK):
                    near = out[row, x + i] + a * weights[j + i] + b * weights[j + i + _BLOCK]
                    near = near + c * weights[j + i + two * _BLOCK] + d * weights[j + i + three * _BLOCK]
                    far = near + e * weights[j + i + four * _BLOCK] + f * weights[j + i + five * _BLOCK]
                    out[row, x + i] = far


@jit
def coarse_rows(wanted: I32, layers: I64, rows: I64, out: I32) -> None:
    """Write the parts of coarse rows, (planes, cy, 2) fine samples, that the `wanted` (layers, ny, 2) depend on.

    `layers` and `rows` are the first taps of fine layers and rows. `out` is zero before.
    """
    for layer in range(wanted.shape[0]):
        for row in range(wanted.shape[1]):
            begin, end = wanted[layer, row, 0], wanted[layer, row, 1]
            if begin < end:
                for p in range(layers[layer], layers[layer] + TAPS):
                    for q in range(rows[row], rows[row] + TAPS):
                        if out[p, q, 0] < out[p, q, 1]:
                            out[p, q, 0], out[p, q, 1] = min(out[p, q, 0], begin), max(out[p, q, 1], end)
                        else:
                            out[p, q, 0], out[p, q, 1] = begin, end


@jit
def logarithms(plane: F32, columns: I32, least: np.float32) -> None:
    """Replace sums (cy, cx), or `least` where they are smaller, by logarithms in the `columns` (cy, 2) of rows."""
    half, two, fraction = np.int32(0x3F3504F3), np.float32(2), np.float32(0.6931471805599453)
    third, fifth, seventh, one = np.float32(1 / 3), np.float32(1 / 5), np.float32(1 / 7), np.float32(1)
    for row in range(plane.shape[0]):
        line = plane[row]
        for i in range(np.uint64(columns[row, 0]), np.uint64(max(columns[row, 0], columns[row, 1]))):
            bits = np.float32(max(line[i], least)).view(np.int32)
            # a power of two and a mantissa between the roots of 1/2 and 2, whose logarithm is 2 artanh t
            power = (bits - half) >> np.int32(23)
            mantissa = np.int32(bits - (power << np.int32(23))).view(np.float32)
            t = (mantissa - one) / (mantissa + one)
            square = t * t
            series = one + square * (third + square * (fifth + square * seventh))
            line[i] = np.float32(power) * fraction + two * t * series


@jit
def _interpolate_rows(
    planes: F32,
    first: I64,
    weights: F32,
    y_first: I64,
    y_weights: F32,
    level: np.float32,
    row_start: int,
    row_stop: int,
    wanted: I32,
    kept: F32,
    field: F32,
    solid: U8,
    threshold: bool,
) -> None:
    """Layer by layer: coarse rows along z, each as far as any fine row near it wants it, then the fine rows."""
    base, n = y_first[row_start], planes.shape[0]
    start = np.empty(kept.shape[0], np.int64)
    stop = np.empty(kept.shape[0], np.int64)
    for layer in range(len(first)):
        start[:], stop[:] = kept.shape[1], 0
        for y in range(row_start, row_stop):
            begin, end = np.int64(wanted[layer, y, 0]), np.int64(wanted[layer, y, 1])
            if begin < end:
                for k in range(y_first[y] - base, y_first[y] - base + TAPS):
                    start[k], stop[k] = min(start[k], begin), max(stop[k], end)
        f = first[layer]
        p0, p1, p2 = planes[f % n], planes[(f + 1) % n], planes[(f + 2) % n]
        p3, p4, p5 = planes[(f + 3) % n], planes[(f + 4) % n], planes[(f + 5) % n]
        for k in range(kept.shape[0]):
            if start[k] < stop[k]:
                span = np.uint64(start[k]), np.uint64(stop[k])
                _between_planes(p0, p1, p2, p3, p4, p5, np.uint64(base + k), weights[layer], kept, np.uint64(k), *span)
        for y in range(row_start, row_stop):
            span = np.uint64(wanted[layer, y, 0]), np.uint64(wanted[layer, y, 1])
            row = np.uint64(y_first[y] - base)
            if span[0] < span[1] and threshold:
                _negative_between_rows(kept, row, y_weights, np.uint64(y), -level, solid[layer], *span)
            elif span[0] < span[1]:
                _between_rows(kept, row, y_weights, np.uint64(y), -level, field[layer], *span)
