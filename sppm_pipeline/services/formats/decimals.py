"""Rows of numbers as decimal text: what OBJ, OFF and 3MF files are made of, up to the words between the numbers.

Eight digits are made at a time, in one register: three multiplications split a number into halves, quarters and single
digits that lie side by side in a word (Lemire, "Converting integers to fix-digit representations quickly", 2021).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.services.arrays import F64, I32, I64, U64
from sppm_pipeline.services.formats.encoding import Bytes, leading_zeros, store8, trailing_zeros
from sppm_pipeline.services.jit.compiled import jit

_LONGEST_WORD = 16
_LONGEST_NUMBER = 28  # "-", 19 digits, "e-" and three digits more are the most there are

_MINUS, _POINT, _ZERO, _E = 45, 46, 48, 101
_ZEROS = np.uint64(0x3030303030303030)
_EIGHT_DIGITS = np.uint64(10**8)
_EXACT = 2**52  # integers that a float64 holds
_POWERS = 10 ** np.arange(19, dtype=np.int64)


class Words(NamedTuple):
    """The text before the first, second and third number of a row, and after the third."""

    texts: U64  # (4, 2): up to 16 characters each, the first one in the lowest byte
    lengths: I64

    @classmethod
    def of(cls, first: bytes, second: bytes, third: bytes, last: bytes) -> Words:
        """Pack four strings of at most 16 characters."""
        words = [first, second, third, last]
        if max(map(len, words)) > _LONGEST_WORD:
            raise ValueError(f"a word between numbers has at most {_LONGEST_WORD} characters")
        packed = b"".join(word.ljust(_LONGEST_WORD, b"\0") for word in words)
        texts = np.frombuffer(packed, "<u8").astype(np.uint64).reshape(4, 2)
        return cls(texts, np.array([len(word) for word in words], np.int64))


def decimal_scale(largest: float) -> tuple[float, int]:
    """Power of ten that turns coordinates up to `largest` into integers of nine to ten digits, and its exponent.

    The rounding error is at most 5e-10 of the power of ten at or above the largest coordinate.
    """
    decimals = min(9 - int(np.ceil(np.log10(largest))), 300) if largest > 0.0 else 0
    return 10.0**decimals, decimals


def vertex_rows(points: NDArray[np.floating], scale: tuple[float, int], words: Words) -> memoryview:
    """The text of coordinates (n, 3), rounded as `decimal_scale` says, without zeros at the end of a number."""
    rows = np.ascontiguousarray(points, np.float64)
    out = _room(rows.shape[0], words)
    return out.data[: _put_vertices(out, rows, scale[0], scale[1], words.texts, words.lengths)]


def face_rows(faces: I32, base: int, words: Words) -> memoryview:
    """The text of vertex numbers (m, 3), the first vertex being `base`."""
    out = _room(faces.shape[0], words)
    return out.data[: _put_faces(out, faces, base, words.texts, words.lengths)]


def _room(rows: int, words: Words) -> Bytes:
    return np.empty(rows * (int(words.lengths.sum()) + 3 * _LONGEST_NUMBER) + _LONGEST_WORD, np.uint8)


@jit
def _put_vertices(out: Bytes, points: F64, scale: float, decimals: int, texts: U64, lengths: I64) -> int:
    short = 0 <= decimals <= 8
    power = _POWERS[decimals] if short else 1
    lift = _POWERS[8 - decimals] if short else 1
    limit = min(power * 100000000, _EXACT)
    inverse = 1.0 / power
    i = 0
    for row in range(points.shape[0]):
        for c in range(3):
            store8(out, i, texts[c, 0])
            store8(out, i + 8, texts[c, 1])
            i += lengths[c]
            value = np.int64(np.rint(points[row, c] * scale))
            # Nothing branches on the digits, which no processor can predict: what is too much is written over.
            out[i] = _MINUS
            i += np.int64(value < 0)
            value = abs(value)
            if short and value < limit:
                # a product takes a quarter of the time of a division, and is at most one off
                whole = np.int64(np.float64(value) * inverse)
                rest = value - whole * power
                step = np.int64(rest >= power) - np.int64(rest < 0)
                whole += step
                rest -= step * power
                digits = _eight_digits(np.uint64(whole))
                unused = min(trailing_zeros(digits) >> 3, 7)
                store8(out, i, (digits | _ZEROS) >> np.uint64(8 * unused))
                i += 8 - unused
                digits = _eight_digits(np.uint64(rest * lift))
                length = 8 - (leading_zeros(digits) >> 3)
                out[i] = _POINT
                store8(out, i + 1, digits | _ZEROS)
                i += length + np.int64(length > 0)
            else:
                i = _put_scaled(out, i, int(value), decimals)
        store8(out, i, texts[3, 0])
        store8(out, i + 8, texts[3, 1])
        i += lengths[3]
    return i


@jit
def _put_faces(out: Bytes, faces: I32, base: int, texts: U64, lengths: I64) -> int:
    i = 0
    for row in range(faces.shape[0]):
        for c in range(3):
            store8(out, i, texts[c, 0])
            store8(out, i + 8, texts[c, 1])
            i += lengths[c]
            number = np.uint64(np.int64(faces[row, c]) + base)
            if number < _EIGHT_DIGITS:
                digits = _eight_digits(number)
                unused = min(trailing_zeros(digits) >> 3, 7)
                store8(out, i, (digits | _ZEROS) >> np.uint64(8 * unused))
                i += 8 - unused
            else:
                i = _put_integer(out, i, int(number))
        store8(out, i, texts[3, 0])
        store8(out, i + 8, texts[3, 1])
        i += lengths[3]
    return i


@jit
def _eight_digits(value: np.uint64) -> np.uint64:
    """The digits of a number below 10^8, one a byte, the first in the lowest byte."""
    halves = value // np.uint64(10000)
    halves = halves | (value - halves * np.uint64(10000)) << np.uint64(32)
    quarters = (halves * np.uint64(10486)) >> np.uint64(20) & np.uint64(0x0000007F0000007F)
    quarters = quarters | (halves - quarters * np.uint64(100)) << np.uint64(16)
    digits = (quarters * np.uint64(103)) >> np.uint64(10) & np.uint64(0x000F000F000F000F)
    return digits | (quarters - digits * np.uint64(10)) << np.uint64(8)


@jit
def _put_integer(out: Bytes, i: int, value: int) -> int:
    """Write any number >= 0 in decimal digits at out[i:]; returns the end."""
    digits = 1
    bound = 10
    while value >= bound and digits < 18:
        bound *= 10
        digits += 1
    for k in range(i + digits - 1, i - 1, -1):
        rest = value // 10
        out[k] = _ZERO + (value - 10 * rest)
        value = rest
    return i + digits


@jit
def _put_scaled(out: Bytes, i: int, value: int, decimals: int) -> int:
    """Write value / 10^decimals >= 0 at out[i:] without zeros at its end, as 12.5 or, for odd sizes, as 125e-40."""
    if value == 0:
        out[i] = _ZERO
        return i + 1
    while value % 10 == 0:
        value //= 10
        decimals -= 1
    if decimals < -9 or decimals > 17:
        i = _put_integer(out, i, value)
        out[i] = _E
        i += 1
        if decimals > 0:
            out[i] = _MINUS
            i += 1
        return _put_integer(out, i, abs(decimals))
    if decimals <= 0:
        i = _put_integer(out, i, value)
        for _ in range(-decimals):
            out[i] = _ZERO
            i += 1
        return i
    whole = value // _POWERS[decimals]
    i = _put_integer(out, i, whole)
    value -= whole * _POWERS[decimals]
    out[i] = _POINT
    for k in range(i + decimals, i, -1):
        rest = value // 10
        out[k] = _ZERO + (value - 10 * rest)
        value = rest
    return i + 1 + decimals
