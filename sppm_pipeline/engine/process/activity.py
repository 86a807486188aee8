"""Activity and deadlines of a supervised process, in a page of memory that it shares with its supervisor.

A process that crashes, hangs with Python's lock held, is stopped or left by ``os._exit`` can't say whose code it was
running; its supervisor reads it here. A worker of a sweep shares a file with its guard (`guard.py`) in the same way.
Only light modules are imported, as the supervisor is forked before anything else.
"""

from __future__ import annotations

import contextlib
import json
import math
import mmap
import os
import struct
import threading
import time
from collections.abc import Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, NamedTuple

from sppm_pipeline.errors import ConfigError, Position

_AREA = 4096
"""Bytes of the texts."""

_RUN, _STAGE, _MEMORY = 0, 1, 2
"""Numbers at the beginning: when the run and when the current stage has to have ended, and bytes that it may take."""

_ENDS = 3 * 8
"""The byte that says whether the process means to end."""

_TEXT, _WORDS = _ENDS + 8, _ENDS + 8 + _AREA
"""Offsets of the activity and of the last message; each is its length and UTF-8."""


class Activity(NamedTuple):
    """Current activity of a process; `kind` ("stage", "import" or "exit") decides which limit ends it.

    `what` is the subject of a sentence, `where` a place in the configuration or empty, `stage` an id or empty.
    """

    what: str
    builtin: bool
    where: str = ""
    stage: str = ""
    kind: str = "stage"

    @property
    def place(self) -> Position | None:
        """Place in the configuration as errors hold it."""
        return Position(self.where, 0, 0) if self.where else None


_shared: mmap.mmap | None = None
_times: Any = memoryview(b"")  # of doubles, which its annotations take for whole numbers
"""The numbers in `_shared`. Each is stored at once; `struct.pack_into` clears what it writes to first, and a supervisor
that looked in between would see a time long past."""

_file: Path | None = None
_run: ContextVar[str] = ContextVar("run", default="")
_lock = threading.Lock()
_active: list[tuple[Activity, float]] = []


def share(file: Path | None = None) -> None:
    """Share what is noted from now on with children forked from this process, or with a reader of `file`."""
    global _shared, _times, _file
    size = _WORDS + _AREA
    if file is None:
        _shared = mmap.mmap(-1, size)
    else:
        with file.open("w+b") as opened:
            opened.truncate(size)
            _shared = mmap.mmap(opened.fileno(), size)
    _times = memoryview(_shared)[:_ENDS].cast("d")
    _times[_RUN] = _times[_STAGE] = _times[_MEMORY] = math.inf
    _shared[_ENDS] = 0
    _file = file


@contextlib.contextmanager
def of_run(name: str) -> Iterator[None]:
    """Note of which run of a sweep it is what is being done in this thread."""
    token = _run.set(name)
    try:
        yield
    finally:
        _run.reset(token)


@contextlib.contextmanager
def doing(activity: Activity, seconds: float = math.inf) -> Iterator[None]:
    """Note the activity, which the supervisor ends after `seconds`; the one before is noted again at the end."""
    if _shared is None:
        yield
        return
    if run := _run.get():
        activity = activity._replace(what=f"{activity.what} of run {run!r}")
    # the clock of `time.monotonic` is one for all processes of a machine
    entry = (activity, time.monotonic() + seconds)
    with _lock:
        _active.append(entry)
        _note()
    try:
        yield
    finally:
        with _lock:
            _active[:] = [other for other in _active if other is not entry]
            _note()


def _note() -> None:
    """Note the last of what is being done; a recipe's stages come after the stage that runs it."""
    assert _shared is not None
    activity = _active[-1][0] if _active else Activity("", True)
    # what is done comes last, as it may be too long and is cut then
    _write(_TEXT, "\0".join(["1" if activity.builtin else "", *activity[2:], activity.what]))
    _times[_STAGE] = min((deadline for _, deadline in _active), default=math.inf)


def _write(at: int, text: str) -> None:
    assert _shared is not None
    data = text.encode("utf-8", "replace")[: _AREA - 2]
    _shared[at : at + 2 + len(data)] = struct.pack("<H", len(data)) + data


def _read(at: int, data: mmap.mmap | bytes | None) -> str:
    if not data:
        return ""
    (length,) = struct.unpack_from("<H", data, at)
    return data[at + 2 : at + 2 + length].decode("utf-8", "replace")


def current(file: Path | None = None) -> Activity | None:
    """Current activity, of several the one begun last; None if nothing was noted.

    With `file`, what the process that shared it was doing when it wrote there last.
    """
    noted = _read(_TEXT, _shared if file is None else file.read_bytes()).split("\0", 4)
    builtin, where, stage, kind, what = noted if len(noted) == 5 else ("", "", "", "", "")
    return Activity(what, bool(builtin), where, stage, kind) if what else None


def running(file: Path | None = None) -> tuple[Activity | None, str, dict[str, Any]]:
    """The `current` activity, as the end of a message, and where in the configuration it stands."""
    now = current(file)
    if now is None:
        return None, "", {}
    return now, f", while this was running: {now.what}", {"where": now.place, "stage": now.stage or None}


def limit_run(seconds: float) -> None:
    """Have the supervisor end this process after so many seconds; `ConfigError` if there is none.

    There is none where the system can't fork processes, or the program is used from Python.
    """
    if _shared is None:
        raise ConfigError("--time-limit needs a supervising process, which only the command on Linux and macOS has")
    _times[_RUN] = time.monotonic() + seconds


def limit_memory(count: int) -> None:
    """Have the supervisor end this process when it and those below it hold more bytes; nothing without a supervisor."""
    if _shared is not None:
        _times[_MEMORY] = float(count)


def memory_limit() -> float:
    """Bytes that the process and those below it may hold."""
    return math.inf if _shared is None else float(_times[_MEMORY])


def deadlines(file: Path | None = None) -> tuple[float, float]:
    """When the run and when the stage has to have ended, on the clock of `time.monotonic`.

    With `file`, those of the process of this machine that shares it.
    """
    if file is not None:
        return struct.unpack_from("dd", file.read_bytes())
    if _shared is None:
        return math.inf, math.inf
    return _times[_RUN], _times[_STAGE]


def overdue_file(notes: Path) -> Path:
    """The file that says of a run of a sweep, beside its shared file, that it has used up its time."""
    return notes.with_name(f"{notes.name}.overdue")


def note_overdue(notes: Path | None = None) -> None:
    """Write into the shared file (that of this process if omitted) what was being done when the time was up."""
    if (notes := notes or _file) is None:
        return
    now = current(notes) or Activity("the run", True)
    with contextlib.suppress(OSError):  # the run directory may be full: the row then counts as one whose process died
        overdue_file(notes).write_text(json.dumps(now), encoding="utf-8")


def overdue(notes: Path) -> Activity | None:
    """Activity of a run of a sweep when its time was up; None if it was not."""
    try:
        return Activity(*json.loads(overdue_file(notes).read_bytes()))
    except (OSError, ValueError, TypeError):
        return None


def leave(code: int) -> None:
    """End this process at once, with an exit code that it means; whatever else ends it has failed."""
    if _shared is not None:
        _shared[_ENDS] = 1
    os._exit(code)


def was_left() -> bool:
    """True if the process has ended by `leave`."""
    return _shared is not None and _shared[_ENDS] == 1


def leave_message(text: str) -> None:
    """Have the supervisor print what this process can't, as its standard error is closed."""
    if _shared is not None:
        _write(_WORDS, text)


def last_message() -> str:
    """Message that the process could not print."""
    return _read(_WORDS, _shared)
