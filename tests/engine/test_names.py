"""Names of outputs stay in the run directory and are possible everywhere, and this is known before any work."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.engine.config.names import collide, folded, output_parts
from sppm_pipeline.errors import ConfigError

BAD = [
    "", ".", "..", "../x", "a/../x", "/etc/passwd", "\\x", "a\\..\\..\\x", "C:/x", "C:x", "a\0b", "a\nb", "a\x1b[2J",
    "run.json", "RUN.JSON", "run.json/x", "sweep.csv", "runs/0000", ".staging-1", ".STAGING-2/x", "a" * 256, "é" * 128,
    "/".join(["abc"] * 400), "con", "CON.png", "aux.tar.gz", "a/nul/b", "com1", "LPT9.txt", "a.", "a ", "a./b", " a",
    "a/ b", "a?b", "a*b", "a|b", "a<b", 'a"b', "a:b", "\ud800", "\ufeffx",
]  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_refused(name):
    with pytest.raises(ConfigError) as caught:
        output_parts(name)
    assert len(caught.value.message) < 300


@pytest.mark.parametrize("name", ["a", "a/b/c.png", "./a", "a//b", "é", "a" * 255, "console.png", "a..b", ".hidden"])
def test_accepted(name):
    assert output_parts(name)


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.text(st.sampled_from("ab./\\: \0con~*é\u0301"), max_size=12))
def test_whatever_is_accepted_stays_inside(name):
    try:
        parts = output_parts(name)
    except ConfigError:
        return
    assert parts
    assert all(part not in ("", ".", "..") and "/" not in part and "\\" not in part for part in parts)


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("a", "A", True),
        ("é", "e\u0301", True),
        ("STRASSE", "straße", True),
        ("a", "a/b", True),
        ("a/b", "a/c", False),
        ("a", "ab", False),
    ],
)
def test_collisions(one, other, same):
    assert collide(folded(output_parts(one)), folded(output_parts(other))) is same


TWO = """pipeline:
  - {{stage: read.number, value: 1}}
  - {{stage: write.number, path: {0}}}
  - {{stage: write.number, path: {1}, id: b}}
"""


@pytest.mark.parametrize(("one", "other"), [("x.txt", "x.txt"), ("x.txt", "X.TXT"), ("x", "x/y"), ("x/y", "x")])
def test_two_stages_that_write_one_file_are_found_before_they_run(work, one, other):
    error = work.error(TWO.format(one, other))
    assert "collides" in error.message
    assert work.place(error) == (5, 33)
    assert error.stage == "b"


@pytest.mark.parametrize("name", ["../x", "/x", "con", "run.json", "a.", '"a\\nb"'])
def test_a_bad_name_is_found_before_any_work(work, name):
    error = work.error(TWO.format(name, "good"))
    assert "option 'path'" in error.message
    assert work.place(error) == (4, 33)
