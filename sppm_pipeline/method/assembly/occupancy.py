"""Occupancy masks: gray pixels by their coverage, and the occupied span of each row."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import I32, U8, U64, Bools
from sppm_pipeline.services.jit.compiled import jit


def gray_by_coverage(samples: U8 | Bools, factor: tuple[int, int]) -> U8:
    """One gray layer (h, w) from a finer occupancy ([s,] h * fy, w * fx), with s sheets if subsampled along z.

    Pixels are 255 times the fraction that is inside (not 0), rounded to the nearest integer, halves upwards.
    """
    sheets = samples[None] if samples.ndim == 2 else samples
    fx, fy = factor
    gray = np.empty((sheets.shape[1] // fy, sheets.shape[2] // fx), dtype=np.uint8)
    _gray(np.ascontiguousarray(sheets).view(np.uint8), fx, fy, gray)
    return gray


def row_spans(mask: U8) -> I32:
    """First sample of each row of a mask (nz, ny, nx) that is set, and the one after the last; (0, 0) for none."""
    spans = np.zeros((*mask.shape[:2], 2), np.int32)
    _spans(mask, spans)
    return spans


def row_spans_of_bits(bits: U64) -> I32:
    """`row_spans` of a mask of bits, (nz, ny, words), see `services.bit_rows`."""
    spans = np.zeros((*bits.shape[:2], 2), np.int32)
    _bit_spans(bits, spans)
    return spans


def spans_in_any(spans: I32) -> I32:
    """Union over the layers of the occupied span of each row: (nz, ny, 2) int32 to (ny, 2); an empty row ends at 0.

    An empty row begins beyond every sample, so that a minimum over rows leaves it out.
    """
    beyond = np.int32(np.iinfo(np.int32).max)
    first, last = spans[..., 0], spans[..., 1]
    there = first < last
    found = np.empty((spans.shape[1], 2), np.int32)
    np.where(there, first, beyond).min(0, initial=beyond, out=found[:, 0])
    np.where(there, last, np.int32(0)).max(0, initial=0, out=found[:, 1])
    return found


@jit
def _gray(samples: U8, fx: int, fy: int, gray: U8) -> None:
    sheets = samples.shape[0]
    per_pixel = sheets * fy * fx
    columns = np.empty(samples.shape[2], np.uint16)
    for y in range(gray.shape[0]):
        columns[:] = 0
        for s in range(sheets):
            for i in range(fy):
                row = samples[s, y * fy + i]
                for x in range(row.size):
                    columns[x] += np.uint16(row[x] != 0)
        for x in range(gray.shape[1]):
            count = 0
            for i in range(fx):
                count += columns[x * fx + i]
            gray[y, x] = (510 * count + per_pixel) // (2 * per_pixel)


@jit
def _spans(mask: U8, spans: I32) -> None:
    nz, ny, nx = mask.shape
    for z in range(nz):
        for y in range(ny):
            first = 0
            while first < nx and mask[z, y, first] == 0:
                first += 1
            if first < nx:
                last = nx - 1
                while mask[z, y, last] == 0:
                    last -= 1
                spans[z, y, 0] = first
                spans[z, y, 1] = last + 1


@jit
def _bit_spans(bits: U64, spans: I32) -> None:
    one = np.uint64(1)
    nz, ny, words = bits.shape
    for z in range(nz):
        for y in range(ny):
            first = 0
            while first < words and bits[z, y, first] == 0:
                first += 1
            if first < words:
                last = words - 1
                while bits[z, y, last] == 0:
                    last -= 1
                low, high = 64 * first, 64 * last + 64
                while bits[z, y, first] >> np.uint64(low & 63) & one == 0:
                    low += 1
                while bits[z, y, last] >> np.uint64((high - 1) & 63) & one == 0:
                    high -= 1
                spans[z, y, 0] = low
                spans[z, y, 1] = high
