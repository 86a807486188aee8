"""Lines, words and numbers of ASCII files, and where they are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import InputError
from sppm_pipeline.services.formats.text import Lines, fan

fixed = settings(derandomize=True, deadline=None, max_examples=300)


def read(word: str) -> float:
    lines = Lines(f"{word} 7\n".encode(), "x")
    (words,) = lines
    return lines.floats(words[:1])[0]


@fixed
@given(value=st.floats(-1e300, 1e300), form=st.sampled_from(["r", ".17g", ".6f", ".9e", ".20f"]))
def test_floats_are_read_as_python_reads_them(value: float, form: str) -> None:
    word = repr(value) if form == "r" else format(value, form)
    if len(word) <= 400:
        assert read(word) == float(word)


@pytest.mark.parametrize("word", ["0", "-0.0", "+5", ".5", "5.", "1E3", "1e-3", "9007199254740993", "1e-400"])
def test_forms_of_numbers(word: str) -> None:
    assert read(word) == float(word)


@pytest.mark.parametrize(
    "word", ["-", ".", "e5", "1e", "1e+", "1.2.3", "1,5", "0x10", "1_0", "12a", "--1", "9" * 500, "\u0663"]
)
def test_what_is_no_number(word: str) -> None:
    with pytest.raises(InputError, match="number"):
        read(word)


@pytest.mark.parametrize("word", ["nan", "inf", "-Infinity", "1e999"])
def test_what_is_not_finite(word: str) -> None:
    with pytest.raises(InputError, match="finite"):
        read(word)


@pytest.mark.parametrize(("word", "expected"), [("12", 12), ("-3", -3), ("+7", 7), ("9" * 18, 10**18 - 1)])
def test_integers(word: str, expected: int) -> None:
    assert Lines(b"", "x").integer(word.encode()) == expected


@pytest.mark.parametrize("word", ["", "-", "1.0", "x", "1_0", "--1", "9" * 19, "\u0663"])
def test_what_is_no_integer(word: str) -> None:
    assert Lines(b"", "x").integer(word.encode()) is None


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_words_and_places(end: str) -> None:
    lines = Lines(end.join(["# one", "a b # c", "", "  d ", "e"]).encode(), "x")
    found = []
    for words in lines:
        found.append(words)
        if words == [b"d"]:
            with pytest.raises(InputError, match=rf"^x: line 4 \(byte {14 + 3 * len(end)}\): no$"):
                lines.fail("no", b"d")
    assert found == [[b"a", b"b"], [b"d"], [b"e"]]


def test_continued_lines_are_one() -> None:
    lines = Lines(b"a \\\nb\nc d\n", "x", continued=True)
    found = [(words, lines.begin) for words in lines]
    assert found == [([b"a", b"b"], 0), ([b"c", b"d"], 6)]


def test_fans_cover_a_polygon() -> None:
    corners = list(range(10, 17))
    triangles = np.reshape(fan(corners), (-1, 3))
    assert triangles[:, 0].tolist() == [10] * 5
    assert triangles[:, 1:].tolist() == [[k, k + 1] for k in range(11, 16)]
