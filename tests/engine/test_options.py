"""From values to options: types, bounds, positions, and back again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sppm_pipeline.engine.config.document import as_node
from sppm_pipeline.engine.config.options import (
    allowed_words,
    hint_of,
    options_of,
    parse_typed,
    plain_option,
    type_words,
)
from sppm_pipeline.errors import PluginError, Position
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Stage, option
from tests.synthetic import Text, Varied

OPTIONS = options_of(Varied)
NUMERIC = ["whole", "number", "length", "pair", "numbers", "maybe", "either", "sizes"]


def parse(name, value):
    return parse_typed(OPTIONS[name], value, Path("/base"))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("flag", True, True),
        ("whole", 3, 3),
        ("whole", 3.0, 3),
        ("number", 0.25, 0.25),
        ("word", "two", "two"),
        ("text", "7.5 mm", "7.5 mm"),
        ("file", "a/b.stl", Path("/base/a/b.stl")),
        ("file", "/abs.stl", Path("/abs.stl")),
        ("file", None, None),
        ("length", 7.5, Length(7.5)),
        ("length", "50 um", Length(50.0, "um")),
        ("pair", [1, 2], (1, 2)),
        ("numbers", [], ()),
        ("numbers", [1, 2.5], (1.0, 2.5)),
        ("maybe", None, None),
        ("maybe", 4, 4),
        ("either", 4, 4),
        ("either", [1, 2, 3], (1, 2, 3)),
        ("sizes", ["1 mm", 2], (Length(1.0, "mm"), Length(2.0))),
    ],
)
def test_accepted(name, value, expected):
    got = parse(name, value)
    assert got == expected
    assert type(got) is type(expected)


def test_a_whole_number_becomes_a_float_where_a_float_is_wanted():
    assert type(parse("numbers", [1])[0]) is float


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("flag", "yes", "true or false"),
        ("flag", 1, "true or false"),
        ("whole", 3.5, "an integer"),
        ("whole", True, "an integer"),
        ("whole", "3", "an integer"),
        ("whole", 11, "at most 10"),
        ("whole", -1, "at least 0"),
        ("whole", 10**400, "at most 10"),
        ("number", 0, "above 0"),
        ("number", 1.0, "below 1"),
        ("number", math.nan, "finite"),
        ("number", math.inf, "finite"),
        ("number", 10**400, "a number"),
        ("word", "tow", "did you mean 'two'"),
        ("word", 2, "one of one, two, three"),
        ("text", 5, "expected a string"),
        ("file", 5, "a path"),
        ("file", "", "a path"),
        ("file", "a\0b", "a path"),
        ("length", "5 parsec", "unknown unit 'parsec'"),
        ("length", 0, "above 0"),
        ("length", "11 cm", "at most 100"),
        ("length", math.nan, "finite"),
        ("length", 10**400, "a length"),
        ("pair", [1], "a list of 2 integers"),
        ("pair", 3, "a list of 2 integers"),
        ("pair", [1, "x"], "element 2"),
        ("pair", [1, 0], "at least 1"),
        ("numbers", [0, math.inf], "element 2"),
        ("either", "x", "an integer or a list of 3 integers"),
        ("either", [1, 2], "a list of 3 integers"),
        ("either", [1, 0, 2], "element 2: expected an integer, at least 1, got 0"),
        ("maybe", "x", "an integer"),
        ("whole", None, "got nothing"),
    ],
)
def test_refused_with_what_is_allowed(name, value, words):
    with pytest.raises(ValueError) as caught:
        parse(name, value)
    assert words in str(caught.value)


def test_physical_lengths_are_compared_in_the_unit_of_the_option():
    assert parse("length", "9 cm") == Length(9.0, "cm")
    with pytest.raises(ValueError):
        parse("length", "110 mm")


def test_lengths_are_checked_in_the_unit_of_the_option():
    assert parse("length", "100000 um") == Length(100000.0, "um")


ODD = st.one_of(
    st.just(math.nan),
    st.just(math.inf),
    st.just(-math.inf),
    st.text(max_size=5).filter(lambda t: not t.strip().replace(".", "").isdigit()),
    st.booleans(),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2),
    st.lists(st.sampled_from([math.nan, "x", None, True, [], {}]), min_size=1, max_size=3),
    st.integers(min_value=10**310),
)


@settings(max_examples=400, deadline=None, derandomize=True)
@given(st.sampled_from(NUMERIC), ODD)
def test_numeric_options_never_take_odd_values(name, value):
    # without an upper bound a huge integer is an integer
    assume(not (name in ("maybe", "either") and isinstance(value, int) and not isinstance(value, bool)))
    with pytest.raises(ValueError):
        parse(name, value)


VALUES = {
    "flag": st.booleans(),
    "whole": st.integers(0, 10),
    "number": st.floats(0, 1, exclude_min=True, exclude_max=True),
    "word": st.sampled_from(["one", "two", "three"]),
    "text": st.text(max_size=10),
    "length": st.builds(Length, st.floats(1e-3, 1, allow_nan=False), st.sampled_from([None, "um", "mm", "µm"])),
    "pair": st.tuples(st.integers(1, 99), st.integers(1, 99)),
    "numbers": st.lists(st.floats(-1, 1e300), max_size=4).map(tuple),
    "maybe": st.none() | st.integers(),
    "either": st.integers(1, 9) | st.tuples(*[st.integers(1, 9)] * 3),
    "file": st.none() | st.just(Path("/a/b")),
    "sizes": st.none() | st.just((Length(0.1, "mm"), Length(1 / 3))),
}


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.data())
def test_options_survive_being_written_and_read(data):
    name = data.draw(st.sampled_from(sorted(VALUES)))
    value = data.draw(VALUES[name])
    assert parse(name, plain_option(value)) == value
    assert parse(name, value) == value


def test_all_errors_of_a_file_with_place_value_and_what_is_allowed(work):
    errors = work.errors(
        """pipeline:
  - stage: read.varied
    whole: eleven
    nubmer: 0.5
    pair: [1, nix]
  - {stage: read.number}
  - {stage: read.number, value: .nan, id: other}
"""
    )
    assert [work.place(error) for error in errors] == [(4, 12), (5, 5), (6, 11), (7, 13), (8, 33)]
    texts = [str(error) for error in errors]
    assert "expected an integer, at least 0, at most 10, got 'eleven'" in texts[0]
    assert "no option 'nubmer'" in texts[1]
    assert "did you mean 'number'" in texts[1]
    assert "element 2: expected a list" not in texts[2]
    assert "'value' is missing: a number" in texts[3]
    assert "got nan, which is not finite" in texts[4]
    assert "stage 'other'" in texts[4]


def test_contradicting_options_are_found_before_any_work(work):
    error = work.error("pipeline:\n  - {stage: read.varied, pair: [5, 3]}\n")
    assert "must be in order" in error.message
    assert work.place(error) == (3, 13)
    assert error.stage == "read.varied"


def test_paths_start_from_the_configuration_and_from_where_they_were_typed(work, monkeypatch):
    other = work.folder / "elsewhere"
    other.mkdir()
    monkeypatch.chdir(other)
    text = "params: {f: in.stl}\npipeline:\n  - {stage: read.varied, file: '${f}'}\n"
    assert work.plan(text).steps[0].stage.file == work.folder / "in.stl"
    assert work.plan(text, p=["f=in.stl"]).steps[0].stage.file == other / "in.stl"
    assert work.plan(text, s=["varied.file=in.stl"]).steps[0].stage.file == other / "in.stl"


def test_words_for_users():
    assert allowed_words(OPTIONS["length"]) == "a length in mm, above 0, at most 100"
    assert allowed_words(OPTIONS["word"]) == "one of one, two, three"
    assert type_words(OPTIONS["either"].kind) == "an integer or a list of 3 integers"


@dataclass(frozen=True, kw_only=True)
class Undeclared(Stage):
    """Has a field that is no option."""

    name: ClassVar[str] = "read.undeclared"
    size: int = 3

    def run(self, context) -> Text:
        return Text("")


@dataclass(frozen=True, kw_only=True)
class Unspeakable(Stage):
    """Has an option that YAML can't express."""

    name: ClassVar[str] = "read.unspeakable"
    table: dict[str, int] = option(None, help="a map")

    def run(self, context) -> Text:
        return Text("")


@dataclass(frozen=True, kw_only=True)
class Ambiguous(Stage):
    """Has an option that the YAML entry needs itself."""

    name: ClassVar[str] = "read.ambiguous"
    recipe: str = option("", help="a word")

    def run(self, context) -> Text:
        return Text("")


@pytest.mark.parametrize(
    ("cls", "words"),
    [(Undeclared, "not declared"), (Unspeakable, "can't express"), (Ambiguous, "can't have an option called 'recipe'")],
)
def test_options_that_break_the_contract(cls, words):
    with pytest.raises(PluginError, match=words):
        options_of(cls)


def test_plain_values_become_nodes():
    node = as_node({"a": [1, "x"]}, Position("f", 1, 1))
    assert node.value["a"].node.value[1].value == "x"


def test_for_no_value_null_is_named():
    @dataclass(frozen=True, kw_only=True)
    class Sized(Stage):
        """A stage."""

        name: ClassVar[str] = "read.sized"
        height: float | None = option(None, help="size along z")
        word: float = option(1.0, help="a factor")

        def run(self, context):
            raise NotImplementedError

    declared = options_of(Sized)
    assert "write null" in hint_of(declared["height"], "none")
    assert hint_of(declared["height"], "tall") == "size along z"
    assert hint_of(declared["word"], "none") == "a factor"
    assert parse_typed(declared["height"], None, Path()) is None


@dataclass(frozen=True, kw_only=True)
class Slipped(Stage):
    """A stage."""

    name: ClassVar[str] = "read.slipped"
    share: float = option(0.5, help="a part of it", above=0, below=1)
    length: Length = option(Length(1.0), help="a size", unit="mm")
    word: str = option("", help="any")
    count: int = option(1, help="how many")

    def run(self, context):
        raise NotImplementedError


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("share", "0,70", "written with a point"),
        ("length", "0,05 mm", "written with a point"),
        ("share", "70 %", "write 0.7, a share of 1"),
        ("share", 70, "write 0.7 for 70 %"),
        ("share", "$porosity", '"${porosity}"'),
    ],
)
def test_slips_of_the_pen_are_named(name, value, words):
    assert words in hint_of(options_of(Slipped)[name], value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("share", 1.2), ("share", "a,b"), ("length", 70), ("word", "0,70"), ("count", "50 %"), ("count", "1,000"),
     ("share", "$")],
)  # fmt: skip
def test_other_values_are_no_slips(name, value):
    declared = options_of(Slipped)[name]
    assert hint_of(declared, value) == declared.spec.help


@pytest.mark.parametrize("number", ["0,05 mm", "0,05"])
def test_a_comma_in_a_map_that_cuts_a_number_in_two_is_named(work, number):
    errors = work.errors(f"pipeline: [{{stage: read.number, value: {number}}}]")
    assert "decimals are written with a point" in str(errors[-1])
