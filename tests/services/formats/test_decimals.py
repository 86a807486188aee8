"""Rows of numbers as text: exact, short, and the same by the quick and by the slow way."""

from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.services.formats.decimals import Words, decimal_scale, face_rows, vertex_rows

fixed = settings(derandomize=True, deadline=None, max_examples=300)
PLAIN = Words.of(b"", b" ", b" ", b"\n")


@fixed
@given(
    values=st.tuples(*[st.integers(-(10**10), 10**10)] * 3),
    decimals=st.one_of(st.integers(-30, 30), st.sampled_from([-300, -290, 290, 300])),
)
def test_coordinates_are_written_exactly(values: tuple[int, int, int], decimals: int) -> None:
    # with a factor of 1 the coordinates are the integers themselves, shifted by the decimals
    text = bytes(vertex_rows(np.array([values], float), (1.0, decimals), PLAIN)).decode()
    assert text.endswith("\n")
    words = text.split()
    for word, value in zip(words, values, strict=True):
        assert Decimal(word) == Decimal(value).scaleb(-decimals)
        assert "." not in word or not word.endswith("0")
        assert not word.startswith(("00", "-0\n", "+"))


@fixed
@given(
    size=st.sampled_from([0.9, 1.0, 7.3, 10.0, 99.999999999, 1e5, 3e8, 2e9, 1e-3, 1e12]),
    shares=st.lists(st.floats(-1, 1), min_size=3, max_size=3),
)
def test_any_size_is_rounded_to_its_ninth_digit(size: float, shares: list[float]) -> None:
    points = np.array([shares]) * size
    scale, decimals = decimal_scale(size)
    words = bytes(vertex_rows(points, (scale, decimals), PLAIN)).split()
    assert [float(word) for word in words] == [float(f"{v:.0f}e{-decimals}") for v in np.rint(points * scale)[0]]


@fixed
@given(numbers=st.lists(st.integers(0, 2**31 - 2), min_size=3, max_size=30), base=st.sampled_from([0, 1]))
def test_vertex_numbers(numbers: list[int], base: int) -> None:
    faces = np.array(numbers[: len(numbers) // 3 * 3], np.int32).reshape(-1, 3)
    words = Words.of(b'<triangle v1="', b'" v2="', b'" v3="', b'"/>\n')
    expected = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>\n' for a, b, c in (faces.astype(int) + base).tolist())
    assert bytes(face_rows(faces, base, words)).decode() == expected


def test_every_number_of_digits() -> None:
    numbers = np.array([n for k in range(10) for n in (10**k - 1, 10**k, 10**k + 1)], np.int32)
    assert bytes(face_rows(numbers.reshape(-1, 3), 0, PLAIN)).split() == [b"%d" % n for n in numbers]


def test_words_are_short() -> None:
    with pytest.raises(ValueError, match="16"):
        Words.of(b"x" * 17, b"", b"", b"")


@pytest.mark.parametrize("largest", [1e-290, 1e-40, 0.001, 1.0, 9.99, 10.0, 12345.0, 1e12, 1e300])
def test_the_scale_keeps_nine_digits(largest: float) -> None:
    scale, decimals = decimal_scale(largest)
    assert 1e8 <= round(largest * scale) <= 1e10
    assert scale == pytest.approx(float(f"1e{decimals}"))


def test_the_scale_of_nothing() -> None:
    assert decimal_scale(0.0) == (1.0, 0)
