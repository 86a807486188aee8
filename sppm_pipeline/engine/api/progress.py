"""Progress of sweeps that Python runs: one line that is written again, in a terminal or below a notebook's cell."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import TextIO


class SweepProgress:
    """How many runs of a sweep have ended, and how long the rest may take.

    Nothing is shown where no one looks: if the stream is neither a terminal nor the output of a notebook.

    Parameters
    ----------
    total : int
    stream : text stream, optional
        Standard error if omitted.
    clock : function, optional
        Seconds.
    """

    def __init__(self, total: int, stream: TextIO | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream or sys.stderr
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
