"""Progress on a terminal and elsewhere, and the notice about compilation."""

from __future__ import annotations

import io
import re
import time

import pytest

from sppm_pipeline.engine.cli import progress
from sppm_pipeline.engine.cli.progress import ProgressLines
from sppm_pipeline.hookspecs import StageEvent
from sppm_pipeline.services.jit import kernel_cache


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def _no_waiting(monkeypatch):
    monkeypatch.setattr(progress, "REDRAW", 0.0)
    monkeypatch.setattr(progress, "SPARSE", 0.0)


class Clock:
    """Seconds that pass only when told."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def events(stream, **options):
    clock = Clock()
    lines = ProgressLines(stream, clock=clock, **options)
    lines.stage_started("slice.field", 2, 3)
    clock.now += 20
    lines.progress("slice.field", False, 25, 100, "layers")
    lines.warning("slice.field", "thin walls")
    lines.sppm_stage_finished(StageEvent("slice.field", "slice.field", None, 82.04, {}, {}))
    lines.stage_started("write.png", 3, 3)
    lines.sppm_stage_finished(StageEvent("write.png", "write.png", None, 0.2, {}, {}, from_cache=True))
    lines.close()


def shown(text: str) -> list[str]:
    """The lines that a terminal shows in the end."""
    rows = [""]
    for piece in re.split(r"(\r\x1b\[K|\n)", re.sub(r"\x1b\[\d+m", "", text)):
        if piece == "\n":
            rows.append("")
        elif piece == "\r\x1b[K":
            rows[-1] = ""
        else:
            rows[-1] += piece
    return rows


@pytest.fixture
def columns(monkeypatch):
    def set_columns(n):
        monkeypatch.setenv("COLUMNS", str(n))

    set_columns(100)
    return set_columns


def test_on_a_terminal_a_bar_goes_on_below_the_stages_that_have_ended(columns):
    stream = Terminal()
    events(stream)
    text = stream.getvalue()
    assert "[2/3] slice.field \x1b[32m|#####...............|\x1b[0m  25% 25/100 layers 20 s, 1:00 min left" in text
    assert shown(text) == [
        "sppm: warning: stage 'slice.field': thin walls",
        "[2/3] slice.field: 82.0 s",
        "[3/3] write.png: kept",
        "",
    ]


def test_elsewhere_there_are_plain_lines(columns):
    stream = io.StringIO()
    events(stream)
    assert stream.getvalue().splitlines() == [
        "[2/3] slice.field: 25%, 25/100 layers, 20 s, 1:00 min left",
        "sppm: warning: stage 'slice.field': thin walls",
        "[2/3] slice.field: 82.0 s",
    ]


@pytest.mark.parametrize(("name", "value"), [("NO_COLOR", "1"), ("TERM", "dumb")])
def test_no_color_for_those_who_want_none(columns, monkeypatch, name, value):
    monkeypatch.setenv(name, value)
    stream = Terminal()
    events(stream)
    assert "\x1b[3" not in stream.getvalue()
    assert ("\r" in stream.getvalue()) == (name == "NO_COLOR")


@pytest.mark.parametrize(
    ("room", "line"),
    [
        (81, "[2/3] slice.field |#####...............|  25% 25/100 layers 20 s, 1:00 min left"),
        (60, "[2/3] slice.field  25% 25/100 layers 20 s, 1:00 min left"),
        (45, "[2/3] slice.field  25% 20 s, 1:00 min left"),
        (12, "[2/3] slice"),
    ],
)
def test_a_narrow_terminal_gets_what_fits(columns, monkeypatch, room, line):
    monkeypatch.setenv("NO_COLOR", "1")
    columns(room)
    stream = Terminal()
    events(stream)
    drawn = stream.getvalue().split("\r\x1b[K")
    assert line in drawn
    assert all(len(row) < room for row in drawn if "\n" not in row)


def test_a_log_has_every_event_with_its_time(columns):
    stream, log = io.StringIO(), io.StringIO()
    events(stream, verbose=True, log=log)
    assert stream.getvalue() == log.getvalue()
    lines = log.getvalue().splitlines()
    assert all(re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d ", line) for line in lines)
    assert [line[20:] for line in lines] == [
        "[2/3] slice.field begins",
        "[2/3] slice.field: 25%, 25/100 layers, 20 s, 1:00 min left",
        "sppm: warning: stage 'slice.field': thin walls",
        "[2/3] slice.field: 82.0 s",
        "[3/3] write.png begins",
        "[3/3] write.png: kept",
    ]


def test_the_clock_goes_on_while_nothing_is_heard(columns, monkeypatch):
    monkeypatch.setattr(progress, "TICK", 0.01)
    stream, clock = Terminal(), Clock()
    lines = ProgressLines(stream, clock=clock)
    lines.stage_started("tune", 1, 1)
    clock.now = 3725
    deadline = time.monotonic() + 60
    while "[1/1] tune 1:02:05 h" not in stream.getvalue() and time.monotonic() < deadline:
        time.sleep(0.01)
    lines.close()
    assert "[1/1] tune 1:02:05 h" in stream.getvalue()


def test_kernels_are_compiled_before_the_first_stage():
    stream, clock = io.StringIO(), Clock()
    lines = ProgressLines(stream, clock=clock)
    lines.compiling(0, 30, 0.0)
    clock.now += 11
    lines.compiling(12, 30, 0.25)
    clock.now += 5
    lines.compiling(30, 30, 1.0)
    lines.stage_started("tune", 1, 2)
    clock.now += 11
    lines.progress("tune", False, 0.5, 1, "")
    assert stream.getvalue().splitlines() == [
        "compiling kernels: 0%, 0 of 30, 0 s",
        "compiling kernels: 25%, 12 of 30, 11 s, 33 s left",
        "compiling kernels: 100%, 30 of 30, 16 s",
        "kernels compiled, 16 s; once, then they are kept",
        "[1/2] tune: 50%, 11 s, 11 s left",
    ]


def test_no_time_is_shown_before_a_tenth_is_done_and_fractions_are_no_counts():
    stream, clock = io.StringIO(), Clock()
    lines = ProgressLines(stream, clock=clock)
    lines.stage_started("crush", 1, 1)
    for share in (0.00495663, 0.0999, 0.1):
        clock.now += 60
        lines.progress("crush", False, share, 1, "strain")
    lines.progress("crush", False, 0.5, 1, "")
    assert stream.getvalue().splitlines() == [
        "[1/1] crush: 0%, strain, 1:00 min",
        "[1/1] crush: 10%, strain, 2:00 min",
        "[1/1] crush: 10%, strain, 3:00 min, 27:00 min left",
        "[1/1] crush: 50%, 3:00 min, 3:00 min left",
    ]


def test_what_a_stage_says_hides_what_its_recipes_say():
    stream = io.StringIO()
    lines = ProgressLines(stream)
    lines.stage_started("tune", 1, 1)
    for inner in (True, False, True):
        lines.progress("tune", inner, 1, 2, "inner" if inner else "outer")
    assert [line.split()[4] for line in stream.getvalue().splitlines()] == ["inner,", "outer,"]


@pytest.mark.parametrize(("done", "total", "share"), [(0, 0, "0%"), (5, 2, "100%"), (-1, 2, "0%")])
def test_odd_numbers_do_no_harm(done, total, share):
    stream = io.StringIO()
    lines = ProgressLines(stream)
    lines.progress("s", False, done, total, "")
    assert share in stream.getvalue()


def test_runs_of_a_sweep(monkeypatch):
    stream, log, clock = io.StringIO(), io.StringIO(), Clock()
    lines = ProgressLines(stream, clock=clock, log=log)
    good = {"run": "0001", "params": {"n": 4}, "error": None, "status": "done", "warnings": [], "seconds": 1.25}
    bad = {"run": "0003", "params": {"n": 5}, "error": {"message": "too tight"}, "warnings": ["thin"]}
    lines.sweep_started("a cluster", 4)
    clock.now = 6
    lines.row_finished(2, 4, good)
    lines.row_finished(4, 4, bad)
    assert stream.getvalue().splitlines() == [
        "sppm: runs on a cluster",
        "sppm: run 0001 (n=4): done, 1.2 s",
        "4 runs: 50%, 2 of 4 done, 6 s, 6 s left",
        "sppm: warning: run 0003 (n=5): thin",
        "sppm: run 0003 (n=5) failed: too tight",
        "4 runs: 100%, 4 of 4 done, 6 s",
    ]
    monkeypatch.setattr(progress, "EACH_ROW", 3)
    stream.truncate(0)
    lines.row_finished(1, 4, good)
    assert "run 0001" not in stream.getvalue()
    assert log.getvalue().count("run 0001 (n=4): done, 1.2 s") == 2


def test_a_stream_that_was_closed_does_no_harm():
    stream, log = io.StringIO(), io.StringIO()
    lines = ProgressLines(stream, log=log)
    stream.close()
    log.close()
    lines.note("nobody hears this")
    lines.close()


def test_the_notice_about_compilation_is_given_once(monkeypatch):
    monkeypatch.setattr(kernel_cache, "waiting", [])
    told = []
    kernel_cache.on_first_compilation(lambda: told.append(1))
    kernel_cache.first_compilation()
    kernel_cache.first_compilation()
    assert told == [1]


def test_numba_gives_the_notice(monkeypatch):
    import numba

    import sppm_pipeline.services.jit.compiling  # noqa: F401 - listens to Numba

    monkeypatch.setattr(kernel_cache, "waiting", [])
    told = []
    kernel_cache.on_first_compilation(lambda: told.append(1))
    assert numba.njit(lambda x: x + 1)(1) == 2
    assert told == [1]


@pytest.mark.parametrize("kind", [io.StringIO, Terminal])
def test_the_quiet_hear_of_warnings_alone(kind):
    stream, log = kind(), io.StringIO()
    events(stream, quiet=True, verbose=True, log=log)
    assert shown(stream.getvalue()) == ["sppm: warning: stage 'slice.field': thin walls", ""]
    assert "write.png" in log.getvalue()
