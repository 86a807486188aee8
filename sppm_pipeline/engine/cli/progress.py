"""Progress on stderr: a bar below the stages that have ended on a terminal, few plain lines elsewhere, a log on demand.

Not by a library: `rich.progress` takes 0.05 s to import, where a run of 512 cells shall take 0.65 s, and does not
support plain lines, logs and rows.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TextIO

from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.errors import harmless
from sppm_pipeline.hookspecs import StageEvent, hookimpl

REDRAW = 0.1
"""Seconds between two redraws on a terminal."""

TICK = 1.0
"""Seconds after which the clock on a terminal goes on though nothing was heard."""

SPARSE = 10.0
"""Seconds between two lines elsewhere."""

EACH_ROW = 60
"""A sweep of at most so many runs leaves a line for each, a longer one for those that warn or fail.
Heuristic: about a screen of lines; twice as many scroll what was said before out of it."""

MIN_SHARE = 0.1
"""Share of the work from which on the time that is left is shown: a heuristic.

The first items carry fixed costs; at 0.02 a run of a minute was announced as half an hour. At 0.2 only short waits show
no time.
"""

_BAR = 20
_RED, _GREEN, _YELLOW = 31, 32, 33


class ProgressLines(Monitor):
    """Shows the events of a run: with `verbose` a line with date and time for each and no bar, with `quiet` only
    warnings. `log` gets these lines as well, whatever is shown; `clock` gives seconds.
    """

    def __init__(
        self,
        stream: TextIO,
        *,
        verbose: bool = False,
        quiet: bool = False,
        log: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream
        self._log = log
        self._verbose, self._quiet = verbose and not quiet, quiet
        self._terminal = stream.isatty() and not verbose and not quiet and os.environ.get("TERM") != "dumb"
        self._color = stream.isatty() and not self._verbose and os.environ.get("TERM") != "dumb"
        self._color = self._color and not os.environ.get("NO_COLOR")
        self._clock = clock
        # stages report from threads of theirs, and the clock of the terminal is another; reentrant, as events are drawn
        # within events
        self._lock = threading.RLock()
        self._closed = threading.Event()
        self._ticking = False
        self._drawn = False
        self._title = ""
        self._outer = False
        self._last = self._begun = clock()
        self._share = 0.0
        self._counts = ""

    def stage_started(self, stage: str, number: int, total: int) -> None:
        self._outer = False
        self._begin(f"[{number}/{total}] {stage}")
        self._record(f"{self._title} begins")

    def compiling(self, done: int, total: int, share: float) -> None:
        """Kernels are compiled, once; then they are kept."""
        if not done:
            self._begin("compiling kernels")
        self._show(share, f"{done} of {total}")
        if done == total:
            self._title = ""
            self._settle(f"kernels compiled, {_duration(self._clock() - self._begun)}; once, then they are kept")

    def not_compiled(self, place: str, why: str) -> None:
        """For those who asked for each event: nothing is lost but time."""
        self._record(f"not compiled: {place}: {why}")

    def progress(self, stage: str, inner: bool, done: float, total: float, what: str) -> None:
        """See `Monitor`; what a stage says itself hides what the stages of its recipes say."""
        if inner and self._outer:
            return
        self._outer = self._outer or not inner
        # fractions count nothing that a person could name, so the percentage stands alone
        counts = f"{done:.0f}/{total:.0f} " if total > 1 and float(done).is_integer() else ""
        self._show(done / total if total > 0 else 0.0, f"{counts}{what}".strip())

    @hookimpl
    def sppm_stage_finished(self, event: StageEvent) -> None:
        """Say how long a stage took."""
        took = "kept" if event.from_cache else f"{event.seconds:.1f} s"
        with self._lock:
            title, self._title = self._title, ""  # not drawn again
            if event.failed:
                self._settle(f"{title}: failed after {took}", color=_RED)
            elif self._terminal or event.seconds > 1:
                self._settle(f"{title}: {took}")
            else:
                self._record(f"{title}: {took}")

    def warning(self, stage: str | None, message: str) -> None:
        self._warn(f"{f'stage {stage!r}: ' if stage else ''}{message}")

    def sweep_started(self, about: str, total: int) -> None:
        if about:
            self.note(f"runs on {about}")
        self._begin(f"{total} runs")

    def crew_started(self, about: str) -> None:
        self.note(f"works on {about}")

    def crew_left_out(self, why: str) -> None:
        self.note(f"this process goes on alone: {why}; --executor processes takes them all the same")

    def row_finished(self, done: int, total: int, row: Mapping[str, Any]) -> None:
        values = ", ".join(f"{name}={value}" for name, value in row["params"].items())
        run = f"run {row['run']} ({values})"
        for message in row["warnings"]:
            self._warn(f"{run}: {message}")
        if row["error"]:
            self.note(f"{run} failed: {row['error']['message']}", color=_RED)
        else:
            seconds = row.get("seconds")
            text = f"{run}: {row['status']}" + ("" if seconds is None else f", {seconds:.1f} s")
            (self.note if total <= EACH_ROW else self._record)(text)
        self._show(done / total, f"{done} of {total} done", last=done == total)

    def note(self, message: str, *, color: int = 0) -> None:
        """A line that stays."""
        self._settle(f"sppm: {message}", color=color)

    def close(self) -> None:
        """Remove the line that redraws itself."""
        self._closed.set()
        with self._lock:
            self._title = ""
            self._clear()

    def _warn(self, message: str) -> None:
        self._settle(f"sppm: warning: {message}", color=_YELLOW, anyhow=True)

    def _begin(self, title: str) -> None:
        with self._lock:
            self._title, self._share, self._counts = title, 0.0, ""
            self._begun = self._clock()
            if self._terminal:
                self._draw()
                if not self._ticking:
                    self._ticking = True
                    threading.Thread(target=self._tick, name="sppm-progress", daemon=True).start()

    def _tick(self) -> None:
        while not self._closed.wait(TICK):
            with self._lock:
                if self._drawn:
                    self._draw()

    def _show(self, share: float, counts: str, *, last: bool = False) -> None:
        """Something has gone on."""
        with self._lock:
            self._share, self._counts = min(max(share, 0.0), 1.0), counts
            if not last and self._clock() - self._last < (REDRAW if self._terminal else SPARSE):
                return
            self._last = self._clock()
            if self._terminal:
                self._draw()
            else:
                self._settle(", ".join(filter(None, (f"{self._title}: {self._share:.0%}", counts, self._times()))))

    def _times(self) -> str:
        """Time since the beginning, and a guess of what is left."""
        elapsed = self._clock() - self._begun
        text = _duration(elapsed)
        if MIN_SHARE <= self._share < 1 and elapsed >= 1:
            text += f", {_duration(elapsed * (1 / self._share - 1))} left"
        return text

    def _draw(self) -> None:
        """The line that redraws itself; what there is no room for is left out, the bar first."""
        room = shutil.get_terminal_size().columns - 1
        filled = round(_BAR * self._share)
        bar = f"|{'#' * filled}{'.' * (_BAR - filled)}|"
        percent = f"{self._share:4.0%}" if self._counts or self._share else ""
        parts = [self._title, bar if percent else "", percent, self._counts, self._times()]
        for dropped in (None, 1, 3, 2):  # bar, counts, percent
            if dropped is not None:
                parts[dropped] = ""
            line = " ".join(part for part in parts if part)
            if len(line) <= room:
                break
        line = line[:room]
        self._write(f"\r\x1b[K{line.replace(bar, self._colored(bar, _GREEN))}")
        self._drawn = True

    def _settle(self, text: str, *, color: int = 0, anyhow: bool = False) -> None:
        """A line that stays, above the one that redraws itself; also for the quiet, if they have to know."""
        text = harmless(text)
        with self._lock:
            drawn = self._drawn
            self._clear()
            self._record(text)
            if not self._verbose and (anyhow or not self._quiet):
                self._write(f"{self._colored(text, color)}\n")
            if drawn and self._title:
                self._draw()

    def _record(self, text: str) -> None:
        """A line with date and time for those who asked for it."""
        with self._lock:
            line = f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n"
            if self._verbose:
                self._write(line)
            if self._log is not None:
                with contextlib.suppress(OSError, ValueError):  # a full disk does not stop a run that writes elsewhere
                    self._log.write(line)
                    self._log.flush()

    def _clear(self) -> None:
        if self._drawn:
            self._write("\r\x1b[K")
            self._drawn = False

    def _colored(self, text: str, color: int) -> str:
        return f"\x1b[{color}m{text}\x1b[0m" if self._color and color else text

    def _write(self, text: str) -> None:
        with self._lock, contextlib.suppress(OSError, ValueError):  # the reader may have gone
            self._stream.write(text)
            self._stream.flush()


def _duration(seconds: float) -> str:
    """As 7 s, 2:05 min or 3:02:05 h."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, hours = whole // 60, whole // 3600
    return f"{hours}:{minutes % 60:02d}:{whole % 60:02d} h" if hours else f"{minutes}:{whole % 60:02d} min"
