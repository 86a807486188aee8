"""Layers of solid and void as bits: each row is some words of 64 samples, the first sample the lowest bit.

An eighth of the memory of a byte a sample, and as much less to read for counting, cutting, finding runs and
encoding. Bits beyond the end of a row are 0.
"""

from __future__ import annotations

import numpy as np

from sppm_pipeline.services.arrays import U8, U64
from sppm_pipeline.services.jit.compiled import inline_jit, jit

_ONE = np.uint64(1)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
# byte i of a word of zeros and ones lands in bit 56 + i; the partial products never meet, so nothing is carried
_GATHER = np.uint64(0x0102040810204080)
_GATHER_SHIFT = np.uint64(56)
_COPIES = np.uint64(0x0101010101010101)
# index of the only set bit: the six top bits of a de Bruijn sequence times that bit are different for each bit
_SEQUENCE = 0x03F79D71B4CB0A89
_DE_BRUIJN, _DE_BRUIJN_SHIFT = np.uint64(_SEQUENCE), np.uint64(58)
_BIT_INDEX = np.argsort([((_SEQUENCE << bit) & 0xFFFFFFFFFFFFFFFF) >> 58 for bit in range(64)]).astype(np.int32)
# halves, quarters and eighths of a byte, for counting bits
_TWOS, _FOURS, _EIGHTS = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F)


def words_of(samples: int) -> int:
    """Words that a row of so many samples takes."""
    return -(-samples // 64)


def empty_bits(layers: int, ny: int, nx: int) -> U64:
    """Room for layers, (layers, ny, words) uint64, not initialized."""
    return np.empty((layers, ny, words_of(nx)), np.uint64)


def pack(mask: U8) -> U64:
    """The bits of layers, (nz, ny, nx) uint8; anything but 0 is set."""
    nz, ny, nx = mask.shape
    # of any order in memory, which `packbits` would keep
    packed = np.ascontiguousarray(np.packbits(mask, axis=2, bitorder="little"))
    if nx % 64:
        rows = np.zeros((nz, ny, 8 * words_of(nx)), np.uint8)
        rows[:, :, : packed.shape[2]] = packed
        packed = rows
    return packed.view(np.uint64)


def unpack(bits: U64, nx: int, value: int = 1) -> U8:
    """Layers as bytes, (nz, ny, nx) uint8, of `value` where a bit is set and 0 elsewhere."""
    layers = np.unpackbits(np.ascontiguousarray(bits).view(np.uint8), axis=2, count=nx, bitorder="little")
    return layers if value == 1 else np.multiply(layers, np.uint8(value), out=layers)


def count(bits: U64) -> int:
    """Number of set bits; `bits` is C-contiguous."""
    return int(_count(bits.reshape(-1)))


@inline_jit
def gather(flags: U64, first: int) -> np.uint64:
    """The word of 64 bytes of 0 or 1, which are flags[first : first + 8]."""
    packed = np.uint64(0)
    for b in range(8):
        packed |= ((flags[first + b] * _GATHER) >> _GATHER_SHIFT) << np.uint64(8 * b)
    return packed


@inline_jit
def clear_span(row: U64, first: int, stop: int) -> None:
    """Take the samples first <= x < stop out of a row; first < stop."""
    for w in range(first // 64, (stop - 1) // 64 + 1):
        row[w] &= ~_span_of_word(w, first, stop)


@inline_jit
def fill_span(row: U64, first: int, stop: int) -> None:
    """Set the samples first <= x < stop of a row; first < stop."""
    for w in range(first // 64, (stop - 1) // 64 + 1):
        row[w] |= _span_of_word(w, first, stop)


@inline_jit
def _span_of_word(word: int, first: int, stop: int) -> np.uint64:
    """The bits of a word that lie in some samples of its row, of which it holds one at least."""
    low, high = max(first - 64 * word, 0), min(stop - 64 * word, 64)
    return (_ALL >> np.uint64(64 - (high - low))) << np.uint64(low)


@inline_jit
def bit_index(bit: np.uint64) -> np.int32:
    """The number of the only bit of a word that is set."""
    index: np.int32 = _BIT_INDEX[(bit * _DE_BRUIJN) >> _DE_BRUIJN_SHIFT]
    return index


@inline_jit
def set_bits(word: np.uint64) -> np.uint64:
    """Number of set bits of a word; compilers know this pattern and emit one instruction for it."""
    pairs = word - ((word >> _ONE) & _TWOS)
    fours = (pairs & _FOURS) + ((pairs >> np.uint64(2)) & _FOURS)
    return (((fours + (fours >> np.uint64(4))) & _EIGHTS) * _COPIES) >> _GATHER_SHIFT


@jit
def _count(words: U64) -> int:
    total = np.uint64(0)
    for word in words:
        total += set_bits(word)
    return int(np.int64(total))
