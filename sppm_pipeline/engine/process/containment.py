"""Running code of plugins: what it raises is caught, what it prints is kept apart, the time it takes is limited.

A plugin is code and runs with the rights of the user; this module is no jail. It keeps a mistake in one plugin
from becoming a puzzle: whatever a plugin does wrong ends in one error that names it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from sppm_pipeline.engine.process import interruption
from sppm_pipeline.engine.process.activity import Activity, doing, leave, note_overdue
from sppm_pipeline.errors import PluginError, Position, ResourceError, SppmError, described

STAGE_TIME = "SPPM_STAGE_TIME"
"""Environment variable with the seconds that one stage may take; worker processes of a sweep inherit it."""

CONTRACT = "SPPM_CONTRACT"
"""Environment variable that adds costly checks of each stage's promises (`--contract`), for those who write plugins."""

GRACE = 10.0
"""Seconds that a stage has to end after its time is up, before the whole process is ended."""


LAST = 2.0
"""Seconds after those in which the supervising process ends a stage whose own process can't."""


class _TimeUp(BaseException):
    """Raised inside a stage whose time is up; no `except Exception` of the stage catches it."""


@contextlib.contextmanager
def contained(fault: Callable[[str], SppmError]) -> Iterator[None]:
    """Run code of a plugin: nothing but an `Exception` leaves, stdout stays clean, the working folder is put back.

    `fault` makes the error that names the plugin, from a description of what it did.
    """
    folder, streams = _working_folder(), _open_streams()
    interrupts = _Interrupts()
    with _REDIRECTION, interrupts:
        try:
            yield
            # a plugin that closes stdout would make every later result vanish
            if lost := streams - _open_streams():
                raise fault(f"closed the standard {' and the standard '.join(sorted(lost))}")
        except (Exception, _TimeUp):
            raise
        except KeyboardInterrupt:
            # a plugin may raise KeyboardInterrupt by itself, which would look like Ctrl-C
            if not (interrupts.seen or interruption.requested()):
                raise fault("raised KeyboardInterrupt, though there was no interrupt") from None
            raise
        except SystemExit as error:
            raise fault(f"tried to end the program (SystemExit: {error.code!r:.80})") from error
        except BaseException as error:
            raise fault(f"raised {described(error):.200}") from error
        finally:
            if folder is not None and _working_folder() != folder:
                os.chdir(folder)


def _working_folder() -> str | None:
    try:
        return os.getcwd()
    except OSError:  # removed while we are in it
        return None


def _open_streams() -> set[str]:
    """Which of the standard streams can be written to; the redirection has put one in the other's place."""
    found = set()
    for name, number, stream in (("output", 1, sys.__stdout__), ("error", 2, sys.stderr)):
        with contextlib.suppress(OSError):
            os.fstat(number)
            if stream is not None and not stream.closed:
                found.add(name)
    return found


IMPORT_TIME = "SPPM_IMPORT_TIME"
"""Environment variable with the seconds that the import of a plugin may take, each of its hooks, and exit handlers."""

IMPORT_SECONDS = 20.0
"""Default of it, a heuristic: large libraries take some seconds from a cold disk."""


def import_seconds() -> float:
    """Seconds that the import of a plugin may take."""
    return _seconds(IMPORT_TIME) or IMPORT_SECONDS


def _seconds(variable: str) -> float | None:
    try:
        seconds = float(os.environ.get(variable, ""))
    except ValueError:
        return None
    return seconds if seconds > 0 else None


def set_environment(values: Mapping[str, str | None]) -> None:
    """Set environment variables of this process, or remove those that are None."""
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextlib.contextmanager
def guarded(what: str, fault: Callable[[str], SppmError], *, builtin: bool) -> Iterator[None]:
    """Run the import or a hook of a plugin as `contained`, built-in code as it is.

    The supervisor ends the process when a plugin takes longer than `import_seconds`.
    """
    if builtin:
        with doing(Activity(what, builtin)):
            yield
        return
    with doing(Activity(what, builtin, kind="import"), import_seconds()), contained(fault):
        yield


class _Interrupts:
    """Notes whether an interrupt came from outside while a plugin ran."""

    def __init__(self) -> None:
        self.seen = False
        self._before: Any = None

    def __enter__(self) -> _Interrupts:
        before = signal.getsignal(signal.SIGINT)
        if threading.current_thread() is threading.main_thread() and callable(before):
            self._before = before
            signal.signal(signal.SIGINT, self._note)
        return self

    def _note(self, number: int, frame: Any) -> None:
        self.seen = True
        self._before(number, frame)

    def __exit__(self, *error: object) -> None:
        if self._before is not None:  # also if the plugin has put another one in its place
            signal.signal(signal.SIGINT, self._before)


class _Redirection:
    """Sends what is printed to stderr as long as any plugin runs, on whichever thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._depth = 0
        self._stdout: Any = None

    def __enter__(self) -> None:
        with self._lock:
            if not self._depth and sys.stderr is not None:
                self._stdout, sys.stdout = sys.stdout, sys.stderr
            self._depth += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._depth -= 1
            if not self._depth and self._stdout is not None:
                sys.stdout, self._stdout = self._stdout, None


_REDIRECTION = _Redirection()


def stage_seconds() -> float | None:
    """Seconds that one stage may take; None if there is no limit."""
    return _seconds(STAGE_TIME)


@contextlib.contextmanager
def limited(what: str, *, builtin: bool, where: Position | None = None, stage: str | None = None) -> Iterator[None]:
    """End what runs inside when the time of a stage is up: `PluginError`, or `ResourceError` if it is built in.

    Python code is interrupted where it is. Compiled code can't be, nor can what sleeps outside of the main thread; if
    it has not returned `GRACE` seconds later, records are put in order and the process is ended, with the same message.
    `what` is the stage and its owner, for the message.
    """
    seconds = stage_seconds()
    activity = Activity(what, builtin, str(where or ""), stage or "")
    if seconds is None:
        with doing(activity):
            yield
        return
    kind = ResourceError if builtin else PluginError
    error = kind(
        f"{what} took longer than the {seconds:g} seconds that a stage may take",
        hint="allow more with --stage-time, or make the work smaller; `sppm estimate` says how long stages take",
        where=where,
        stage=stage,
    )
    watchdog = _Watchdog(seconds, error)
    try:
        # compiled code that keeps Python's lock stops the watchdog as well; the supervisor is the last to look
        with doing(activity, seconds + GRACE + LAST), watchdog:
            yield
    except _TimeUp:
        if not watchdog.fired:  # that of a stage around this one
            raise
        raise error from None


class _Watchdog:
    """A thread that raises `_TimeUp` in the thread it was made in."""

    def __init__(self, seconds: float, error: SppmError) -> None:
        self._seconds, self._error = seconds, error
        self._thread = threading.get_ident()
        self._main = threading.current_thread() is threading.main_thread() and hasattr(signal, "SIGALRM")
        self._done = threading.Event()
        self._lock = threading.Lock()
        self._before: Any = None
        self.fired = False

    def __enter__(self) -> None:
        if self._main:  # a signal also wakes what sleeps or waits
            self._before = signal.signal(signal.SIGALRM, self._raise)
        threading.Thread(target=self._watch, name="sppm-stage-time", daemon=True).start()

    def __exit__(self, *error: object) -> None:
        try:
            with self._lock:  # the signal may arrive just here
                self._done.set()
        finally:
            self._done.set()
            if self._main:
                signal.signal(signal.SIGALRM, self._before)
            elif self.fired:  # what has not been delivered must not hit what comes after the stage
                interruption.raise_in(self._thread, None)

    def _raise(self, number: int, frame: Any) -> None:
        if not self._done.is_set():
            raise _TimeUp

    def _watch(self) -> None:
        if self._done.wait(self._seconds):
            return
        with self._lock:
            if self._done.is_set():
                return
            self.fired = True
            if self._main:
                signal.pthread_kill(self._thread, signal.SIGALRM)
            else:
                interruption.raise_in(self._thread, _TimeUp)
        if not self._done.wait(GRACE):
            note_overdue()
            interruption.cancel_all(self._error, self._thread)
            with contextlib.suppress(OSError, ValueError):
                os.write(2, f"\nsppm: {self._error}\n  it could not be interrupted; the process is ended\n".encode())
            leave(self._error.exit_code)
