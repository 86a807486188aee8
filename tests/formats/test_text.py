"""Numbers in text: read with correct rounding, written in decimal digits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.formats.text import (
    as_lines,
    pending_floats,
    resolve_floats,
    scan_float,
    scan_index,
)

fixed = settings(derandomize=True, deadline=None, max_examples=300)


def read(word: str) -> float:
    data = as_lines(f"{word} 7".encode())
    value, end, exact = scan_float(data, 0)
    assert end == len(word)
    if not exact:
        pending, values = pending_floats(1), np.empty(1)
        pending[0] = 0, 0, end
        resolve_floats(data, pending, values, "x")
        value = values[0]
    return float(value)


@fixed
@given(value=st.floats(-1e300, 1e300), form=st.sampled_from(["r", ".17g", ".6f", ".9e", ".20f"]))
def test_floats_are_read_as_python_reads_them(value: float, form: str) -> None:
    word = repr(value) if form == "r" else format(value, form)
    if len(word) <= 400:
        assert read(word) == float(word)


@fixed
@given(mantissa=st.integers(10**15, 10**22), point=st.integers(0, 25))
def test_long_mantissas_are_rounded_once(mantissa: int, point: int) -> None:
    digits = str(mantissa).zfill(point + 1)
    word = f"{digits[: len(digits) - point]}.{digits[len(digits) - point :]}"
    assert read(word) == float(word)


@pytest.mark.parametrize(
    "word",
    [
        "0",
        "-0.0",
        "+5",
        ".5",
        "5.",
        "1E3",
        "1e-3",
        "-1.25e+02",
        "9007199254740993",
        "1e-400",
        "1e30",
        "123e31",
        "9e38",
        "0.5000000000000000000000000001",
    ],
)
def test_forms_of_numbers(word: str) -> None:
    assert read(word) == float(word)


@pytest.mark.parametrize(
    "word", ["", "-", ".", "e5", "1e", "1e+", "1.2.3", "1,5", "0x10", "1_0", "12a", "--1", "9" * 500]
)
def test_what_is_no_number(word: str) -> None:
    with pytest.raises(InputError, match="number"):
        read(word)


@pytest.mark.parametrize("word", ["nan", "inf", "-Infinity", "1e999"])
def test_what_is_not_finite(word: str) -> None:
    with pytest.raises(InputError, match="finite"):
        read(word)


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("12 ", (12, 2, True)),
        ("-3/4", (-3, 2, True)),
        ("+7", (7, 2, True)),
        ("999999999999999999", (10**18 - 1, 18, True)),
    ],
)
def test_integers(word: str, expected: tuple[int, int, bool]) -> None:
    assert scan_index(as_lines(word.encode()), 0) == expected


@pytest.mark.parametrize("word", ["", "-", "1.0", "x", "9" * 19, "9" * 40])
def test_what_is_no_integer(word: str) -> None:
    assert not scan_index(as_lines(word.encode()), 0)[2]
