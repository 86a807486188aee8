"""What the child tells while it works: lines of JSON through a pipe."""

from __future__ import annotations

import json
import os

LONGEST_LINE = 511
"""Bytes of a line; with its end any system writes it to a pipe in one piece."""

_LONGEST_STEP = 36
"""Characters of a step's name; JSON makes up to six bytes of each, of the rarest twelve."""

_channel: int | None = None


def connect(channel: int) -> None:
    """Tell through this file descriptor from now on; the child calls it once."""
    global _channel
    _channel = channel


def tell(step: str, done: float = 0, total: float = 0) -> None:
    """Name the step that begins now, and how far the work is.

    To be called in the child: if it dies or runs out of time, the error names the last step it told. Anywhere else
    this does nothing, so that the function can be called and tested without a child.

    Parameters
    ----------
    step : str
        What is being done, as a person would call it: ``"close holes"``; cut after 36 characters.
    done, total : float
        Progress in any unit; without a total only the step is told.
    """
    global _channel
    if _channel is None:
        return
    line = json.dumps([step[:_LONGEST_STEP], float(done), float(total)])
    try:
        os.write(_channel, line.encode() + b"\n")
    except OSError:  # the library has closed what it did not open; the work is worth more than the telling
        _channel = None
