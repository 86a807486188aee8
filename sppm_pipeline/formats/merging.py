"""Equal positions found by their bits."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.numerics.compiled import jit

_RECENT = 2**15
"""Rows that are remembered beside the table, within half a megabyte: most corners were used a moment ago."""


def merge_equal(rows: NDArray[np.float32] | NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find equal rows (n, 3), bit by bit: 0 and -0 differ.

    Returns
    -------
    first : (k,) int64
        The first row of each different one, in the order of appearance.
    numbers : (n,) int64
        Each row's number among the different ones.
    """
    bits = np.ascontiguousarray(rows).view(np.uint32)
    numbers = np.empty(bits.shape[0], np.int64)
    first = np.empty(1 << max(10, (len(bits) // 8).bit_length()), np.int64)
    recent = np.zeros((_RECENT, 4), np.uint32)
    row = count = 0
    # Corners repeat some six times; the table is made for that, and grows if they repeat less.
    while True:
        slots = np.full(2 * first.size, -1, np.int32)
        _enter(bits, first[:count], slots)
        row, count = _merge(bits, row, recent, slots, first, count, numbers)
        if row == bits.shape[0]:
            return first[:count], numbers
        first = np.concatenate([first, np.empty_like(first)])


@jit
def _merge(
    bits: NDArray[np.uint32],
    row: int,
    recent: NDArray[np.uint32],
    slots: NDArray[np.int32],
    first: NDArray[np.int64],
    count: int,
    numbers: NDArray[np.int64],
) -> tuple[int, int]:
    """Number rows from `row` on until all are done, or `first` is full; returns the next row and the count."""
    mask = np.int64(slots.size - 1)
    for i in range(row, bits.shape[0]):
        a, b, c = bits[i, 0], bits[i, 1], bits[i, 2]
        h = _hash(a, b, c)
        near = h >> 40 & np.int64(_RECENT - 1)
        if recent[near, 0] == a and recent[near, 1] == b and recent[near, 2] == c and recent[near, 3] > 0:
            numbers[i] = np.int64(recent[near, 3]) - 1
            continue
        slot = h & mask
        number = np.int64(slots[slot])
        while number >= 0:
            other = first[number]
            if bits[other, 0] == a and bits[other, 1] == b and bits[other, 2] == c:
                break
            slot = (slot + 1) & mask
            number = np.int64(slots[slot])
        if number < 0:
            if count == first.size:
                return i, count
            number = np.int64(count)
            slots[slot] = number
            first[count] = i
            count += 1
        numbers[i] = number
        recent[near, 0], recent[near, 1], recent[near, 2] = a, b, c
        recent[near, 3] = np.uint32(number + 1)
    return bits.shape[0], count


@jit
def _enter(bits: NDArray[np.uint32], first: NDArray[np.int64], slots: NDArray[np.int32]) -> None:
    """Enter rows that are known to differ into an empty table."""
    mask = np.int64(slots.size - 1)
    for number in range(first.size):
        i = first[number]
        slot = _hash(bits[i, 0], bits[i, 1], bits[i, 2]) & mask
        while slots[slot] >= 0:
            slot = (slot + 1) & mask
        slots[slot] = number


@jit
def _hash(a: np.uint32, b: np.uint32, c: np.uint32) -> np.int64:
    h = np.uint64(a) | np.uint64(b) << np.uint64(32)
    h = (h ^ (h >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    h = ((h ^ (h >> np.uint64(32))) + np.uint64(c)) * np.uint64(0x94D049BB133111EB)
    return np.int64((h ^ (h >> np.uint64(31))) & np.uint64(0x7FFFFFFFFFFFFFFF))
