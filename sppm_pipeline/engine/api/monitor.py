"""What Python shows of runs: warnings at the line of the caller, and the progress of sweeps."""

from __future__ import annotations

import io
import os
import re
import sys
import time
import warnings
from collections.abc import Callable
from typing import TextIO

import sppm_pipeline
from sppm_pipeline.engine.run.events import Monitor

_PACKAGE = os.path.dirname(str(sppm_pipeline.__file__)) + os.sep


class SppmWarning(UserWarning):
    """Something that does not stop a run, for instance tunnels that the resolution can't show.

    >>> import warnings, sppm_pipeline as sppm
    >>> warnings.filterwarnings("ignore", category=sppm.SppmWarning, message="nothing says so")
    """


class WarningMonitor(Monitor):
    """Turns what a run warns of into Python's warnings, at the line of the caller outside of this package."""

    def __init__(self) -> None:
        frame = sys._getframe(1)
        # here and not in `warning`, which threads of the run call
        while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
            frame = frame.f_back
        self._file, self._line = frame.f_code.co_filename, frame.f_lineno
        self._module = str(frame.f_globals.get("__name__", "__main__"))
        self._registry = frame.f_globals.setdefault("__warningregistry__", {})

    def warning(self, stage: str | None, message: str) -> None:
        self._warn(f"{stage}: {message}" if stage else message)

    def _warn(self, text: str) -> None:
        warnings.warn_explicit(text, SppmWarning, self._file, self._line, self._module, self._registry)


class SweepWarnings(WarningMonitor):
    """The warnings of the runs of a sweep, each kind shown once at its end: those that differ in numbers are one."""

    def __init__(self) -> None:
        super().__init__()
        self._kinds: dict[str, list[str]] = {}

    def warning(self, stage: str | None, message: str) -> None:
        text = f"{stage}: {message}" if stage else message
        self._kinds.setdefault(re.sub(r"[\d.]+", "#", text), []).append(text)

    def close(self) -> None:
        """Warn of all that was kept."""
        for _, texts in sorted(self._kinds.items()):
            # the first in an order that does not depend on threads
            more = f" (and alike {len(texts) - 1} times more in this sweep)" if len(texts) > 1 else ""
            self._warn(min(texts) + more)


class SweepProgress:
    """How many runs of a sweep have ended, and how long the rest may take; nothing is shown where no one looks, on a
    stream that is neither a terminal nor the output of a notebook.
    """

    def __init__(self, total: int, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream or sys.stderr or io.StringIO()  # a program without a console has no standard error
        self._clock = clock
        self._total, self._done, self._failed = total, 0, 0
        self._begun = clock()
        # the streams of a notebook's kernel are no terminals, but are shown at once, and "\r" begins the line again
        self._shown = self._stream.isatty() or type(self._stream).__module__.startswith("ipykernel")
        self._width = 0
        self._write(f"sweep: 0 of {total} runs")

    def row_finished(self, well: bool) -> None:
        """One run has ended, well or not."""
        self._done += 1
        self._failed += not well
        left = (self._clock() - self._begun) / self._done * (self._total - self._done)
        text = f"sweep: {self._done} of {self._total} runs"
        text += f", {self._failed} failed" if self._failed else ""
        self._write(text + (f", {left:.0f} s left" if self._done < self._total and left >= 1 else ""))

    def close(self) -> None:
        """End the line."""
        if self._shown:
            self._stream.write("\n")
            self._stream.flush()

    def _write(self, text: str) -> None:
        if self._shown:
            # blanks over what is left of a longer line
            self._stream.write(f"\r{text:{self._width}}")
            self._stream.flush()
            self._width = len(text)
