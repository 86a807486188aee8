"""Progress on stderr: a line that redraws itself on a terminal, few lines elsewhere."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Mapping
from typing import Any, TextIO

from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.hookspecs import StageEvent, hookimpl

REDRAW = 0.1
"""Seconds between two redraws on a terminal."""

SPARSE = 10.0
"""Seconds between two lines elsewhere."""


class ProgressLines(Monitor):
    """Shows the events of a run.

    Parameters
    ----------
    stream : text stream
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._terminal = stream.isatty()
        self._lock = threading.Lock()
        self._drawn = ""
        self._title = ""
        self._outer = False
        self._last = time.monotonic()

    def stage_started(self, stage: str, number: int, total: int) -> None:
        """See `Monitor`."""
        self._title = f"[{number}/{total}] {stage}"
        self._outer = False
        if self._terminal:
            self._draw(self._title)

    def progress(self, stage: str, inner: bool, done: float, total: float, what: str) -> None:
        """See `Monitor`; what a stage says itself hides what the stages of its recipes say."""
        if inner and self._outer:
            return
        self._outer = self._outer or not inner
        now = time.monotonic()
        if now - self._last < (REDRAW if self._terminal else SPARSE):
            return
        share = min(max(done / total, 0.0), 1.0) if total > 0 else 0.0
        counts = f"{done:g}/{total:g} {what}".rstrip()
        if self._terminal:
            filled = round(20 * share)
            self._draw(f"{self._title} |{'#' * filled}{'.' * (20 - filled)}| {share:4.0%} {counts}")
        else:
            self._write(f"{self._title}: {share:.0%}, {counts}\n")
        self._last = now

    @hookimpl
    def sppm_stage_finished(self, event: StageEvent) -> None:
        """Say how long a stage took; on a terminal the line of the next stage takes the place of this one."""
        if not self._terminal and not event.failed and event.seconds > 1:
            self._write(f"{self._title}: {event.seconds:.1f} s\n")

    def warning(self, stage: str | None, message: str) -> None:
        """See `Monitor`."""
        self.note(f"warning: {f'stage {stage!r}: ' if stage else ''}{message}")

    def sweep_started(self, about: str) -> None:
        """See `Monitor`."""
        self.note(f"runs on {about}")

    def row_finished(self, done: int, total: int, row: Mapping[str, Any]) -> None:
        """See `Monitor`."""
        values = ", ".join(f"{name}={value}" for name, value in row["params"].items())
        for message in row["warnings"]:
            self.note(f"warning: run {row['run']} ({values}): {message}")
        if row["error"]:
            self.note(f"run {row['run']} ({values}) failed: {row['error']['message']}")
        now = time.monotonic()
        if self._terminal:
            self._draw(f"{done}/{total} runs")
        elif now - self._last > SPARSE or done == total:
            self._write(f"{done}/{total} runs\n")
            self._last = now

    def note(self, message: str) -> None:
        """A line that stays."""
        drawn = self._drawn
        self._clear()
        self._write(f"sppm: {message}\n")
        if drawn:
            self._draw(drawn)

    def close(self) -> None:
        """Remove the line that redraws itself."""
        self._clear()

    def _draw(self, text: str) -> None:
        width = shutil.get_terminal_size().columns - 1
        self._write(f"\r\x1b[K{text[:width]}")
        self._drawn = text

    def _clear(self) -> None:
        if self._drawn:
            self._write("\r\x1b[K")
            self._drawn = ""

    def _write(self, text: str) -> None:
        with self._lock, contextlib.suppress(OSError, ValueError):  # nobody may be listening any more
            self._stream.write(text)
            self._stream.flush()
