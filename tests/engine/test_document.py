"""YAML to plain values with positions; hostile documents."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.engine.config.document import Override, parse_yaml, plain, read_yaml, yaml_text
from sppm_pipeline.engine.config.names import output_parts
from sppm_pipeline.errors import ConfigError


def refused(text: str) -> tuple[str, int, int]:
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, "f.yaml")
    where = caught.value.where
    assert where is not None
    assert where.file == "f.yaml"
    return caught.value.message, where.line, where.column


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1E3", 1000.0),
        ("no", "no"),
        ("on", "on"),
        ("yes", "yes"),
        ("true", True),
        ("False", False),
        ("~", None),
        ("null", None),
        ("'1'", "1"),
        ('"true"', "true"),
        ("0o17", 15),
        ("0x1F", 31),
        ("017", 17),
        ("1_000", "1_000"),
        ("12:30", "12:30"),
        (".5", 0.5),
        ("5.", 5.0),
        ("-3", -3),
        (".inf", math.inf),
        ("-.INF", -math.inf),
        ("7.5 mm", "7.5 mm"),
        ("2001-01-01", "2001-01-01"),
        ("[1, [2, x], {a: b}]", [1, [2, "x"], {"a": "b"}]),
    ],
)
def test_scalars_follow_yaml_1_2(text, value):
    got = plain(parse_yaml(text, Override("-p x")))
    assert got == value
    assert type(got) is type(value)


def test_not_a_number_is_a_float():
    assert math.isnan(plain(parse_yaml(".nan", Override("-p x"))))


def test_every_key_and_value_knows_its_place():
    root = parse_yaml("a: 1\nb:\n  - {c: [x,   y]}\n", "f.yaml")
    b = root.value["b"]
    assert (b.where.line, b.where.column) == (2, 1)
    c = b.node.value[0].value["c"]
    assert (c.where.line, c.where.column) == (3, 6)
    y = c.node.value[1]
    assert str(y.where) == "f.yaml:3:15"


def test_values_of_the_command_line_lie_there():
    node = parse_yaml("[1, 2]", Override("-p x=[1, 2]"))
    assert str(node.value[1].where) == "-p x=[1, 2]"


@pytest.mark.parametrize(
    ("text", "words", "line", "column"),
    [
        ("", "empty", 1, 1),
        ("# nothing\n", "empty", 1, 1),
        ("a: 1\nb: [1,\n  2\nc: 3\n", "not valid YAML", 4, 2),
        ("a: 1\n\tb: 2\n", "not valid YAML", 2, 1),
        ("a: 1\na: 2\n", "given twice; first at f.yaml:1:1", 2, 1),
        ("a: {b: 1, c: 2, b: 3}\n", "given twice", 1, 17),
        ("a: !!python/object:os.system x\n", "tags", 1, 4),
        ("a: !x 1\n", "tags", 1, 4),
        ("? [1, 2]\n: 3\n", "keys must be strings", 1, 3),
        ("1: 2\n", "keys must be strings, got 1", 1, 1),
        ("a: *b\n", "alias", 1, 4),
        ("a: &a [1, *a]\n", "alias", 1, 11),
        ("a: 1\n---\nb: 2\n", "one YAML document", 2, 1),
        ("a: 1\nb: \x07\n", "control character", 2, 4),
        ("a: " + "9" * 2000, "too many digits", 1, 4),
        ("a: 0x" + "f" * 2000, "too many digits", 1, 4),
        ("a: 1." + "0" * 2000, "too many digits", 1, 4),
        ("a: {<<: 3}\n", "merge key", 1, 9),
        ("x: &x {a: 1}\ny: {<<: *x, <<: *x}\n", "second merge key", 2, 13),
    ],
)
def test_what_is_refused_is_refused_at_its_place(text, words, line, column):
    message, at_line, at_column = refused(text)
    assert words in message
    assert (at_line, at_column) == (line, column)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: 1\n\tb: 2\n", "no tabs"),
        ("a:\n  - 1\n   - 2\nb:\n  - 1\n - 2\n", "alike"),
        ("a: [1, \u201c{b}\u201d]\n", "straight quotes"),
        ("- \u2018{b}: c\u2019: 1\n", "straight quotes"),
        ("a: {b: 1\nc: [2]\n", "closing bracket"),
        ("a:\n  - 1\nb:\n  - 1\n - 2  # the part\u2019s\n", "alike"),
    ],
)
def test_what_to_do_about_a_slip_of_the_syntax(text, words):
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, "f.yaml")
    assert words in (caught.value.hint or "")


def test_aliases_and_merge_keys_work():
    text = "x: &x {a: 1, b: 2}\ny: &y {b: 5}\nz: {<<: [*x, *y], a: 0}\nw: *x\n"
    assert plain(parse_yaml(text, "f")) == {
        "x": {"a": 1, "b": 2},
        "y": {"b": 5},
        "z": {"a": 0, "b": 2},
        "w": {"a": 1, "b": 2},
    }


def bombs() -> dict[str, str]:
    aliases = "a0: &a0 [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"a{i}: &a{i} [{','.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
    )
    merges = "a0: &a0 {k: v, l: w}\n" + "".join(
        f"a{i}: &a{i} {{<<: [{','.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 12)
    )
    return {
        "aliases": aliases,
        "merge keys": merges,
        "flow nesting": "a: " + "[" * 40_000,
        "map nesting": "a: " + "{a: " * 40_000,
        "block nesting": "- " * 40_000,
        "values": "a: [" + "1," * 100_000 + "]",
    }


@pytest.mark.parametrize("kind", bombs())
def test_bombs_are_refused_before_they_are_built(kind):
    events = 0
    import ruamel.yaml

    original = ruamel.yaml.YAML.parse

    def counted(self, stream):
        nonlocal events
        for event in original(self, stream):
            events += 1
            yield event

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ruamel.yaml.YAML, "parse", counted)
        message, line, column = refused(bombs()[kind])
    assert any(words in message for words in ("deeper than", "more than", "longer than"))
    assert events <= 21_000
    assert line <= 12
    assert column >= 1


def test_large_files_are_refused_unread(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_bytes(b"a: 1\n" + b"#" * (1 << 20))
    with pytest.raises(ConfigError, match="larger than 256 KiB"):
        read_yaml(path)


def test_bytes_that_are_no_utf8_are_found(tmp_path):
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"sppm: 1\nname: caf\xe9\n")
    with pytest.raises(ConfigError) as caught:
        read_yaml(path)
    assert str(caught.value.where) == f"{path}:2:10"


def test_a_byte_order_mark_is_fine(tmp_path):
    path = tmp_path / "bom.yaml"
    path.write_bytes(b"\xef\xbb\xbfsppm: 1\n")
    assert plain(read_yaml(path)) == {"sppm": 1}


@pytest.mark.parametrize("name", ["nothing.yaml", "config.yaml/inside", "."])
def test_files_that_are_not_there(tmp_path, name):
    (tmp_path / "config.yaml").write_text("a: 1")
    with pytest.raises(ConfigError):
        read_yaml(tmp_path / name)


def test_of_a_run_record_only_the_configuration_is_read(tmp_path):
    record = {"sppm_run": 1, "config": {"sppm": 1, "name": "x"}, "stages": [{"big": "y" * (3 << 20)}]}
    path = tmp_path / "run.json"
    path.write_text(json.dumps(record, indent=1))
    assert plain(read_yaml(path)) == {"sppm": 1, "name": "x"}


json_values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=20),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text("abc.# '", min_size=1, max_size=5), inner, max_size=4)
    ),
    max_leaves=12,
)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(json_values)
def test_json_is_yaml(value):
    assert plain(parse_yaml(json.dumps(value, indent=1), "f.json")) == value


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.text(st.sampled_from("ab:-[]{}&*!|>'\"#%@,?\n \t0.<~\x00é"), max_size=60))
def test_any_text_is_read_or_refused(text):
    error = None
    try:
        parse_yaml(text, "f.yaml")
    except ConfigError as caught:
        error = caught
    assert error is None or (error.where is not None and error.where.line >= 1)


def test_a_record_that_was_cut_off_is_refused(tmp_path: Path):
    path = tmp_path / "run.json"
    path.write_text('{"sppm_run": 1, "config": {"sppm": 1, "name"')
    with pytest.raises(ConfigError):
        read_yaml(path)


def test_a_pipe_is_no_configuration(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ConfigError, match="is a pipe or a device, not a configuration file"):
        yaml_text(tmp_path / "pipe.yaml")


@pytest.mark.parametrize("mark", ["\u202e", "\u2066", "\u200f"])
def test_a_name_that_turns_the_order_of_letters_round_is_refused(mark, tmp_path):
    with pytest.raises(ConfigError, match=f"u{ord(mark):04x}"):
        output_parts(f"layers{mark}gnp.exe")
    path = tmp_path / f"cell{mark}lmay.yaml"
    path.write_text("sppm: 1\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=f"the name of the file has the character .u{ord(mark):04x}"):
        read_yaml(path)
