"""Configurations that mean harm are refused unparsed, or while they are parsed, at their line and column."""

from __future__ import annotations

import contextlib
import gc
import time

import pytest

from sppm_pipeline.engine.config.document import (
    MAX_BYTES,
    MAX_KEY,
    MAX_LINE,
    MAX_NODES,
    MAX_SCALAR,
    Override,
    parse_yaml,
    plain,
    read_yaml,
)
from sppm_pipeline.errors import ConfigError

BIG = 1 << 17


def refused(text: str) -> tuple[str, int, int]:
    with pytest.raises(ConfigError) as caught:
        parse_yaml(text, "f.yaml")
    error = caught.value
    assert error.where is not None
    assert len(str(error)) < 400, "the message repeats the bomb"
    assert str(error).isprintable() or "hint" in str(error)
    return error.message, error.where.line, error.where.column


@pytest.mark.parametrize(
    ("text", "words", "place"),
    [
        ("a: 1\nb: !" + "x" * BIG, "longer than 65536", (2, 1)),
        ("a: 1\nb: !" + "x" * 5000 + " 1", "without a blank", (2, 4)),
        ("a: 1\nb: &" + "x" * 5000 + " 1", "without a blank", (2, 4)),
        ("a: 1\nb: *" + "x" * 5000, "without a blank", (2, 4)),
        ("a: 1\nb: " + "x" * 5000, "without a blank", (2, 4)),
        ("a: 1\nb: " + "x " * 3000, "longer than 4096 characters", (2, 4)),
        ('a: 1\nb: "' + "x " * 3000 + '"', "longer than 4096 characters", (2, 4)),
        ("a: 1\nb: |\n" + "  x\n" * 3000, "longer than 4096 characters", (2, 4)),
        ("a: 1\nb: >\n" + "  x\n" * 3000, "longer than 4096 characters", (2, 4)),
        ("a: 1\n? " + "k " * 300 + "\n: 1", "longer than 200 characters", (2, 3)),
        ("a: 1\n" + "k" * 300 + ": 1", "longer than 200 characters", (2, 1)),
        ("a: 1\n" + "k" * 1100 + ": 1", "not valid YAML", (2, 1101)),
        ("a: 1\n" + "[" * BIG, "longer than 65536", (2, 1)),
        ("a: 1\nb: " + "[" * 200, "deeper than", (2, 4)),
        ("a: 1\nb: " + "{ [" * 200, "deeper than", (2, 4)),
        ("a: 1\nb: " + "[" * 50, "deeper than", (2, 36)),
        ("a: 1\nb:" + " " * 100 + "!" * 200, "tag", (2, 103)),
        ("%TAG ! tag:x,2000:" + "a" * 5000 + "\n---\na: 1", "without a blank", (1, 14)),
        ('a: 1\nb: "x\\0y"', "\\u0000 is not allowed", (2, 4)),
        ('a: 1\nb: "x\\ud800y"', "\\ud800 is not allowed", (2, 4)),
        ('a: 1\nb: "x\\e[2Jy"', "\\u001b is not allowed", (2, 4)),
        ('a: 1\n"b\\0": 1', "\\u0000 is not allowed", (2, 1)),
        ("a: 1\nb: \x00", "control character", (2, 4)),
        ("a: &x {b: *x}", "alias *x comes before the end", (1, 11)),
        ("a: &x [*x]", "alias *x comes before the end", (1, 8)),
        ("x: &x {<<: *x}", "alias *x comes before the end", (1, 12)),
        ("a: {<<: {<<: {<<: 1}}}", "merge key", (1, 19)),
        ("a: !!binary aGVsbG8=", "tags", (1, 4)),
        ("a: !!set {x, y}", "tags", (1, 4)),
        ("a: !!python/object/apply:os.system ['x']", "tags", (1, 4)),
        ("a: !<tag:yaml.org,2002:str> x", "tags", (1, 4)),
    ],
)  # fmt: skip
def test_refused_at_its_place(text, words, place):
    message, line, column = refused(text)
    assert words in message
    assert (line, column) == place


@pytest.mark.parametrize(
    ("data", "words", "place"),
    [
        ("sppm: 1\n".encode("utf-16"), "UTF-16", (1, 1)),
        ("sppm: 1\n".encode("utf-32"), "UTF-32", (1, 1)),
        ("sppm: 1\n".encode("utf-16-le"), "control character", (1, 2)),
        (b"\xef\xbb\xbfsppm: 1\nname: \xef\xbb\xbfx\n", "not allowed", (2, 7)),
        (b"\x1f\x8b\x08\x00", "gzip", (1, 1)),
        (b"PK\x03\x04", "ZIP", (1, 1)),
        (b"sppm: 1\nname: \xc3\xa9\xff", "byte 0xff is not UTF-8", (2, 8)),
        (b"sppm: 1\nname: \xc0\x80", "byte 0xc0 is not UTF-8", (2, 7)),
        (b"sppm: 1\nname: \xed\xa0\x80", "byte 0xed is not UTF-8", (2, 7)),
        (b"\x00" * 100, "control character", (1, 1)),
        (b"a: 1\n" * MAX_BYTES, "larger than 256 KiB", (1, 1)),
    ],
)
def test_encodings(tmp_path, data, words, place):
    path = tmp_path / "f.yaml"
    path.write_bytes(data)
    with pytest.raises(ConfigError) as caught:
        read_yaml(path)
    assert words in caught.value.message
    assert caught.value.where is not None
    assert (caught.value.where.line, caught.value.where.column) == place


@pytest.mark.parametrize("version", ["1.0", "1.3", "1.9", "1.22", "2.0", "x", ""])
def test_another_version_of_yaml(version):
    message, line, column = refused(f"# a comment\n\n%YAML {version}\n---\na: 1\n")
    assert f"says that it is YAML {version}" in message
    assert (line, column) == (3, 1)


@pytest.mark.parametrize("version", ["1.1", "1.2"])
def test_versions_that_are_read(version):
    assert plain(parse_yaml(f"%YAML {version}\n---\na: no\nb: |\n  %YAML 1.9\n", "f")) == {
        "a": "no",
        "b": "%YAML 1.9\n",
    }


def seconds(text: str) -> float:
    gc.collect()
    gc.disable()  # it would look through all that other tests have left
    began = time.process_time()
    try:
        with contextlib.suppress(ConfigError):
            parse_yaml(text, "f.yaml")
        return time.process_time() - began
    finally:
        gc.enable()


@pytest.mark.parametrize(
    "line",
    ["# " + "x " * 32_000, "# " + "x" * 4000, "- |\n  " + "xx " * 1300, "- |\n  " + " " * 60_000],
    ids=["long comments", "long words", "block texts", "blanks"],
)
def test_the_time_grows_with_the_size_only(line):
    # what was quadratic took 40 to 1000 times as long as these short lines of the same size
    size = 190_000
    text = "sppm:\n" + f"{line}\n" * (size // len(line))
    assert seconds(text) < 10 * seconds("sppm:\n" + "# x x x\n- |\n  xx\n" * (size // 17)) + 0.2


def test_values_of_the_command_line_have_the_same_limits():
    for text in ("[" * 50, "x" * 5000, "!" + "x" * BIG, "[" + "1," * 30_000 + "]", "&a [*a]", "!!str x", '"\\0"'):
        with pytest.raises(ConfigError) as caught:
            parse_yaml(text, Override("-p x"))
        assert str(caught.value.where) == "-p x"


def test_what_is_just_inside_is_read():
    word = "x" * MAX_SCALAR
    assert plain(parse_yaml(f"a: {word}", "f")) == {"a": word}
    key = "k" * MAX_KEY
    assert plain(parse_yaml(f"{key}: 1", "f")) == {key: 1}
    line = "a: [" + "12345, " * 9000 + "1]"
    assert len(line) < MAX_LINE
    assert len(plain(parse_yaml(line, "f"))["a"]) == 9001


def test_a_parameter_put_in_many_times_is_no_bomb(work):
    text = (
        f"params: {{x: [{'1, ' * 2000}1]}}\n"
        "pipeline:\n  - {stage: read.varied, numbers: '${x}'}\n" + "  - {stage: read.varied, numbers: '${x}'}\n" * 12
    )
    error = work.error(text)
    assert f"more than {MAX_NODES} values" in error.message
    assert error.where is not None
    assert error.where.line > 3


def test_all_errors_of_a_file_come_at_once_in_its_order(work):
    errors = work.errors(
        "naem: x\nseed: -1\nparams: {a-b: 1}\nplugins: [3]\nsweep: 7\nafter: [x]\n"
        "recipes: {r: [nope], s: [{stage: read.varied, whole: x}]}\n"
        "pipeline:\n  - {stage: read.varied, whole: 99, nubmer: 1}\n  - {stage: tune.repeat, recipe: q}\n  - 3\n"
    )
    lines = [error.where.line for error in errors]
    assert lines == sorted(lines)
    assert set(lines) == {2, 3, 4, 5, 6, 7, 8, 10, 11, 12}


@pytest.mark.parametrize(
    "seed", ["-1", "1.5", "true", ".nan", ".inf", str(2**63), "1" + "0" * 400, "x", "[1]", "{a: 1}", "1e300"]
)
def test_seeds(work, seed):
    error = work.error(f"seed: {seed}\npipeline: [{{stage: read.varied}}]\n")
    assert "at least 0" in error.message
    assert work.place(error) == (2, 7)


@pytest.mark.parametrize("to", ["1" + "0" * 400, "1e300", ".nan", "true", "x", "-5", "[1]"])
def test_ranges_of_sweeps(work, to):
    from sppm_pipeline.engine.config.parameters import sweep_rows

    text = (
        f"params: {{a: 1}}\nsweep: {{a: {{from: 1, to: {to}}}}}\npipeline: [{{stage: read.varied, whole: '${{a}}'}}]\n"
    )
    session = work.session(text)
    with pytest.raises(ConfigError) as caught:
        sweep_rows(session.configuration.sweep, session.configuration.params)
    assert caught.value.where.line == 3


def test_a_long_sweep_is_checked_by_a_part_of_its_rows(work, monkeypatch):
    from sppm_pipeline.engine.plan import checking

    planned = []
    original = checking.plan

    def noting(opened, row=None):
        planned.append(None if row is None else row["a"].node.value)
        return original(opened, row)

    monkeypatch.setattr(checking, "plan", noting)
    text = "params: {a: 1}\nsweep: {a: {from: 1, to: 50000}}\npipeline: [{stage: read.number, value: '${a}'}]\n"
    checking.checked(work.session(text))
    assert planned.pop(0) is None  # the run without a row
    assert len(planned) <= checking.MAX_CHECKED + 1
    assert (planned[0], planned[-1]) == (1, 50000)
