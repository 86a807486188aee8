"""Numbers in ASCII mesh files: compiled scanners that know where they are."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import InputError
from sppm_pipeline.numerics.compiled import jit

Bytes = NDArray[np.uint8]

# With a mantissa below 2^53 and one of these powers, a single division or product is correctly rounded (Clinger, 1990).
_POWERS = 10.0 ** np.arange(23)
_EXACT = np.uint64(2**53)
_SPLIT = 134217729.0  # 2^27 + 1
_DOUBT = 2.0**-40  # far above the relative error of the second half of the quotient
_TEN = np.uint64(10)
_LONGEST = 400  # characters of one number
_AT_ONCE = 65536  # places that are Python integers at a time

_NEWLINE, _CARRIAGE, _SPACE, _HASH, _BACKSLASH = 10, 13, 32, 35, 92
_PLUS, _MINUS, _POINT, _SLASH, _ZERO, _NINE, _E, _LOWER = 43, 45, 46, 47, 48, 57, 69, 32


def as_lines(data: bytes | memoryview | bytearray) -> Bytes:
    """The bytes as a read-only array whose lines end in a line feed (old files end them in a carriage return only)."""
    array = np.frombuffer(data, np.uint8)
    if array.size and not (array[:65536] == _NEWLINE).any() and not (array == _NEWLINE).any():
        array = np.where(array == _CARRIAGE, np.uint8(_NEWLINE), array)
    array.flags.writeable = False
    return array


def fail_at(data: Bytes, position: int, name: str, message: str, hint: str | None = None) -> NoReturn:
    """Raise the InputError for a place in a text file: ``NAME: line L (byte B): MESSAGE``."""
    position = min(max(int(position), 0), data.size)
    line = 1 + int(np.count_nonzero(data[:position] == _NEWLINE))
    raise InputError(f"{name}: line {line} (byte {position}): {message}", hint=hint)


def shown(data: Bytes, position: int) -> str:
    """The word at a place, for a message."""
    word = data[position : position + 40].tobytes().split(maxsplit=1)
    return repr(word[0].decode("ascii", "backslashreplace")) if word else "the end of the line"


def pending_floats(values: int) -> NDArray[np.int64]:
    """Room for the places (value, start, end) of numbers that `scan_float` leaves to `resolve_floats`."""
    return np.empty((values, 3), np.int64)


def resolve_floats(data: Bytes, pending: NDArray[np.int64], values: NDArray[np.float64], name: str) -> None:
    """Write the numbers that need more than one rounding, or are none, into the flat `values`.

    Raises
    ------
    InputError
        If one of them is no number, or not a finite one.
    """
    if pending.shape[0] == 0:
        return
    text = data.tobytes()
    numbers = np.empty(pending.shape[0])
    for first in range(0, pending.shape[0], _AT_ONCE):
        for k, (start, end) in enumerate(pending[first : first + _AT_ONCE, 1:].tolist(), first):
            word = text[start : min(end, start + _LONGEST + 1)]
            try:
                if b"_" in word or len(word) > _LONGEST:
                    raise ValueError
                numbers[k] = float(word)
            except ValueError:
                fail_at(data, start, name, f"a number is expected, not {shown(data, start)}")
    infinite = np.flatnonzero(~np.isfinite(numbers))
    if infinite.size:
        start = int(pending[infinite[0], 1])
        fail_at(data, start, name, f"a coordinate must be finite, not {shown(data, start)}")
    values[pending[:, 0]] = numbers


@jit
def skip_blanks(data: Bytes, i: int) -> int:
    """First place from i that is no blank within the line; a backslash before the line's end continues the line."""
    while i < data.size:
        c = data[i]
        if c == _BACKSLASH and i + 1 < data.size and data[i + 1] == _NEWLINE:
            i += 2
        elif c == _BACKSLASH and i + 2 < data.size and data[i + 1] == _CARRIAGE and data[i + 2] == _NEWLINE:
            i += 3
        elif c <= _SPACE and c != _NEWLINE:
            i += 1
        else:
            break
    return i


@jit
def skip_token(data: Bytes, i: int) -> int:
    """First place from i that is a blank, a line's end or a comment."""
    while i < data.size and data[i] > _SPACE and data[i] != _HASH:
        i += 1
    return i


@jit
def skip_line(data: Bytes, i: int) -> int:
    """Start of the next line."""
    while i < data.size and data[i] != _NEWLINE:
        i += 1
    return i + 1


@jit
def scan_float(data: Bytes, i: int) -> tuple[float, int, bool]:
    """Value and end of the number at i, and whether the value is exact; what is not, goes to `resolve_floats`."""
    start = i
    negative = False
    if i < data.size and (data[i] == _MINUS or data[i] == _PLUS):
        negative = data[i] == _MINUS
        i += 1
    mantissa = np.uint64(0)
    digits, significant, power = 0, 0, 0
    point, cut = False, False
    while i < data.size:
        c = data[i]
        if _ZERO <= c <= _NINE:
            digits += 1
            if significant > 0 or c != _ZERO:
                significant += 1
            if significant <= 19:
                mantissa = mantissa * _TEN + np.uint64(c - _ZERO)
            else:
                cut = True
                power += 1
            if point:
                power -= 1
        elif c == _POINT and not point:
            point = True
        else:
            break
        i += 1
    if i < data.size and (data[i] | _LOWER) == (_E | _LOWER) and digits > 0:
        i += 1
        sign = 1
        if i < data.size and (data[i] == _MINUS or data[i] == _PLUS):
            sign = -1 if data[i] == _MINUS else 1
            i += 1
        exponent, exponent_digits = 0, 0
        while i < data.size and _ZERO <= data[i] <= _NINE and exponent_digits < 6:
            exponent = 10 * exponent + (data[i] - _ZERO)
            exponent_digits += 1
            i += 1
        power += sign * exponent
        if exponent_digits == 0:
            digits = 0
    ends = i == data.size or data[i] <= _SPACE or data[i] == _HASH
    if ends and digits > 0 and 22 < power <= 37 and not cut:
        scaled = np.float64(mantissa) * _POWERS[power - 22]  # 1e30 is 1e8 * 1e22, and both are exact
        if mantissa < _EXACT and scaled < np.float64(_EXACT):
            return (-scaled if negative else scaled) * _POWERS[22], i, True
    if ends and digits > 0 and -22 <= power <= 22:
        if (mantissa < _EXACT or power == 0) and not cut:
            value = np.float64(mantissa) / _POWERS[-power] if power < 0 else np.float64(mantissa) * _POWERS[power]
            return -value if negative else value, i, True
        if power <= 0:
            value, exact = _long_quotient(mantissa, _POWERS[-power])
            if exact and cut:
                above, exact = _long_quotient(mantissa + np.uint64(1), _POWERS[-power])
                exact = exact and above == value  # whatever the digits left out
            if exact:
                return -value if negative else value, i, True
    return 0.0, max(skip_token(data, i), start), False


@jit
def _long_quotient(mantissa: np.uint64, divisor: float) -> tuple[float, bool]:
    """Quotient of an integer below 10^19 and a power of ten, and whether it is surely rounded correctly.

    The quotient is found to twice the precision; it is refused where that does not tell to which side to round.
    """
    high = np.float64(mantissa)
    low = np.float64(np.int64(mantissa - np.uint64(high)))
    quotient = high / divisor
    product = quotient * divisor
    # The error of the product, by splitting both factors in halves (Dekker, 1971).
    a = quotient * _SPLIT
    a -= a - quotient
    b = divisor * _SPLIT
    b -= b - divisor
    error = ((a * b - product) + a * (divisor - b) + (quotient - a) * b) + (quotient - a) * (divisor - b)
    rest = (((high - product) - error) + low) / divisor
    value = quotient + rest * (1.0 - _DOUBT)
    return value, value == quotient + rest * (1.0 + _DOUBT)


@jit
def scan_index(data: Bytes, i: int) -> tuple[int, int, bool]:
    """Value and end of the integer at i, and whether there is one of at most 18 digits; it may stop at a slash."""
    negative = i < data.size and data[i] == _MINUS
    if negative or (i < data.size and data[i] == _PLUS):
        i += 1
    value = 0
    digits = 0
    while i < data.size and _ZERO <= data[i] <= _NINE and digits < 19:
        value = 10 * value + (data[i] - _ZERO)
        digits += 1
        i += 1
    ends = i == data.size or data[i] <= _SPACE or data[i] == _HASH or data[i] == _SLASH
    if negative:
        value = -value
    return value, i, bool(ends and 0 < digits < 19)
