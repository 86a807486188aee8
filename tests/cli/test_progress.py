"""Progress on a terminal and elsewhere, and the notice about compilation."""

from __future__ import annotations

import io

import pytest

from sppm_pipeline.cli import progress
from sppm_pipeline.cli.progress import ProgressLines
from sppm_pipeline.hookspecs import StageEvent
from sppm_pipeline.numerics import kernel_cache


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch):
    monkeypatch.setattr(progress, "REDRAW", 0.0)
    monkeypatch.setattr(progress, "SPARSE", 0.0)


def events(lines: ProgressLines) -> None:
    lines.stage_started("slice.field", 2, 3)
    lines.progress("slice.field", False, 25, 100, "layers")
    lines.warning("slice.field", "thin walls")
    lines.sppm_stage_finished(StageEvent("slice.field", "slice.field", None, 2.0, {}, {}))
    lines.close()


def test_a_terminal_gets_one_line_that_redraws_itself():
    stream = Terminal()
    events(ProgressLines(stream))
    text = stream.getvalue()
    assert "|#####...............|  25% 25/100 layers" in text
    assert "sppm: warning: stage 'slice.field': thin walls\n" in text
    assert text.endswith("\r\x1b[K")
    assert text.count("\n") == 1


def test_elsewhere_there_are_plain_lines():
    stream = io.StringIO()
    events(ProgressLines(stream))
    assert stream.getvalue().splitlines() == [
        "[2/3] slice.field: 25%, 25/100 layers",
        "sppm: warning: stage 'slice.field': thin walls",
        "[2/3] slice.field: 2.0 s",
    ]


def test_what_a_stage_says_hides_what_its_recipes_say():
    stream = io.StringIO()
    lines = ProgressLines(stream)
    lines.stage_started("tune", 1, 1)
    for inner in (True, False, True):
        lines.progress("tune", inner, 1, 2, "inner" if inner else "outer")
    assert [line.split()[-1] for line in stream.getvalue().splitlines()] == ["inner", "outer"]


@pytest.mark.parametrize(("done", "total", "share"), [(0, 0, "0%"), (5, 2, "100%"), (-1, 2, "0%")])
def test_odd_numbers_do_no_harm(done, total, share):
    stream = io.StringIO()
    lines = ProgressLines(stream)
    lines.progress("s", False, done, total, "")
    assert share in stream.getvalue()


def test_runs_of_a_sweep():
    stream = io.StringIO()
    row = {"run": "0003", "params": {"n": 5}, "error": {"message": "too tight"}, "warnings": ["thin"]}
    ProgressLines(stream).row_finished(4, 4, row)
    assert stream.getvalue().splitlines() == [
        "sppm: warning: run 0003 (n=5): thin",
        "sppm: run 0003 (n=5) failed: too tight",
        "4/4 runs",
    ]


def test_a_stream_that_was_closed_does_no_harm():
    stream = io.StringIO()
    lines = ProgressLines(stream)
    stream.close()
    events(lines)


def test_the_notice_about_compilation_is_given_once(monkeypatch):
    monkeypatch.setattr(kernel_cache, "waiting", [])
    told = []
    kernel_cache.on_first_compilation(lambda: told.append(1))
    kernel_cache.first_compilation()
    kernel_cache.first_compilation()
    assert told == [1]


def test_numba_gives_the_notice(monkeypatch):
    import numba

    import sppm_pipeline.numerics.compiled  # noqa: F401 - listens to Numba

    monkeypatch.setattr(kernel_cache, "waiting", [])
    told = []
    kernel_cache.on_first_compilation(lambda: told.append(1))
    assert numba.njit(lambda x: x + 1)(1) == 2
    assert told == [1]
