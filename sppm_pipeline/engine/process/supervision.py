"""The supervising parent of a run: the work is done by a child process, which can be ended whatever it is doing.

Python handles a signal only between two of its steps, and a native library may keep it from taking one for minutes.
The parent has nothing else to do. It asks the child to end, ends it by force after a moment, puts the run directory
in order, and knows the right exit code; it does the same when a native library takes the child down. The child is
forked before anything heavy is imported, which takes a millisecond.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from sppm_pipeline.engine.process import activity, interruption
from sppm_pipeline.engine.process.budget import format_bytes
from sppm_pipeline.engine.process.containment import IMPORT_TIME, import_seconds
from sppm_pipeline.engine.process.tree import adopt_orphans, die_with_parent, resident_below, signal_below
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, SppmError

PATIENCE = 1.1
"""Seconds that the child is given to end by itself; within `interruption.PATIENCE` it puts everything in order."""

LOOK = 0.5
"""Seconds after which the parent looks whether the child has used up its time."""

SLOW_IMPORT = 3.0
"""Seconds after which a message names the plugin that is being imported: a heuristic."""

ORPHANS = 1.0
"""Seconds that processes which the child has left behind are given to end by themselves."""

INTERRUPTED = (129, 130, 143)
"""Exit codes of a child that was interrupted."""

ENDING = tuple(getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n))
"""Signals by which a user or the system ends a program."""

CRASHES = tuple(getattr(signal, n) for n in ("SIGSEGV", "SIGBUS", "SIGABRT", "SIGILL", "SIGFPE") if hasattr(signal, n))
"""Signals by which a native library takes a process down."""


MarkEnded = Callable[[Path, str, SppmError | None], None]
"""Puts a run directory in order: its path, the status ("interrupted" or "failed"), and what ended the process."""


def supervised(work: Callable[[], int], notify: Callable[[str], None], exit_message: str, mark_ended: MarkEnded) -> int:
    """Do `work` in a child process, which is left at once when it ends, and return its exit code.

    `notify` and `exit_message` are for the user, the latter if the work was interrupted; `mark_ended(path, status,
    error)` puts a run directory in order that the child can't put in order any more.
    """
    if not hasattr(os, "fork"):
        return work()
    wake, alarm, reader, writer = _pipes()
    for stream in (sys.stdout, sys.stderr):  # or the child would write it once more
        with contextlib.suppress(OSError, ValueError, AttributeError):
            stream.flush()
    parent = os.getpid()
    # before the fork, so that both have the page
    activity.share()
    # until each of the two has said what it does with a signal, one that comes has to wait
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        child = os.fork()
    except OSError:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        raise
    if child == 0:
        # the terminal sends its signals to both; the parent decides what becomes of them
        for number in (signal.SIGINT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        for unused in (wake, alarm, reader):
            os.close(unused)
        _parents.append(parent)
        die_with_parent(parent)
        _announce_runs(writer)
        code = 1
        try:
            code = work()
        finally:
            activity.leave(code)
    os.close(writer)
    watch = _Watch(child, (wake, alarm), reader, notify, exit_message, mark_ended)
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return watch.exit_code()


def _pipes() -> tuple[int, int, int, int]:
    """A pipe that wakes the parent and one for what the child reports; both before there is a child, or none."""
    made: list[int] = []
    try:
        for _ in range(2):
            made += os.pipe()
    except OSError:
        for descriptor in made:
            os.close(descriptor)
        raise
    wake, alarm, reader, writer = made
    return wake, alarm, reader, writer


_parents: list[int] = []


def is_supervised() -> bool:
    """True if this is the child of `supervised`."""
    return bool(_parents)


class _Watch:
    """The parent's side."""

    def __init__(
        self,
        child: int,
        waking: tuple[int, int],
        reader: int,
        notify: Callable[[str], None],
        exit_message: str,
        mark_ended: MarkEnded,
    ) -> None:
        self._child = child
        self._reader = reader
        self._notify = notify
        self._exit_message = exit_message
        self._mark_ended = mark_ended
        self._signals: list[int] = []
        self._reported = b""
        self._memory: float | None = None
        self._slow: set[str] = set()
        self._listening = [waking[0], reader]
        self._wake, alarm = waking
        # the handler of a signal must never wait
        os.set_blocking(alarm, False)
        os.set_blocking(self._wake, False)
        os.set_blocking(reader, False)
        signal.set_wakeup_fd(alarm, warn_on_full_buffer=False)
        for number in ENDING:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._arrived)
        signal.signal(signal.SIGCHLD, lambda number, frame: None)

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        self._signals.append(number)

    def exit_code(self) -> int:
        """Wait for the child, and end it when a signal comes or its time is up; then end what it has left behind."""
        adopt_orphans()
        try:
            status = self._wait(None, 0)
            code = self._ended(status) if status is not None else self._stop()
            if words := activity.last_message():
                self._notify(words)
            return code
        finally:
            self._end_orphans()

    def _stop(self) -> int:
        """End the child because of a signal, or of its time."""
        status, arrived = None, len(self._signals)
        if arrived:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._child, signal.SIGTERM)
            # asked first: the child puts its records in order itself
            status = self._wait(time.monotonic() + PATIENCE, arrived)
        error = None if self._signals else self._overdue()
        if status is None:
            # its children first, while they can be found below it
            signal_below(self._child, signal.SIGKILL)
            os.kill(self._child, signal.SIGKILL)
            os.waitpid(self._child, 0)
            self._read()
            self._tidy_up("interrupted" if error is None else "failed", error)
        if error is not None:
            self._notify(str(error))
            return error.exit_code
        self._notify(self._exit_message)
        return 128 + self._signals[0]

    def _overdue(self) -> SppmError:
        """That the child has used up its time, by what it was doing."""
        now, doing, place = activity.running()
        if time.monotonic() >= activity.deadlines()[0]:
            hint = "allow more with --time-limit; the same command again goes on with the stages that had ended"
            return ResourceError(f"the run took longer than --time-limit allows{doing}", hint=hint, **place)
        if now is not None and now.kind != "stage":
            message = f"{now.what} took longer than {import_seconds():g} s, and the process was ended"
            return PluginError(message, hint=f"leave it out with --no-plugins, or allow more with {IMPORT_TIME}")
        if self._memory is not None:
            message = f"the run takes {format_bytes(self._memory)}, more than --memory allows{doing}"
            hint = "allow more with --memory; the same command again goes on with the stages that had ended"
            return ResourceError(message, hint=hint, **place)
        kind = ResourceError if now is None or now.builtin else PluginError
        hint = "allow more with --stage-time; it could not be interrupted, so the process was ended"
        return kind(f"a stage took longer than --stage-time allows{doing}", hint=hint, **place)

    def _ended(self, status: int) -> int:
        """The exit code, of a child that has ended by itself."""
        now, doing, place = activity.running()
        if not os.WIFSIGNALED(status):
            code = os.WEXITSTATUS(status)
            # a plugin that calls os._exit(0) must not look like success
            if not activity.was_left():  # by whatever, but not by the program
                kind = SppmError if now is None or now.builtin else PluginError
                who = now.what if now is not None else "something"
                return self._failed(kind(f"{who} ended the process (exit code {code})", **place), kind.exit_code)
            if code in INTERRUPTED:
                self._notify(self._exit_message)
            if code == ResourceError.exit_code:  # what its last record would have taken is free now
                self._tidy_up("failed", None)
            return code
        number = os.WTERMSIG(status)
        name = signal.Signals(number).name
        if number in CRASHES:
            hint = (
                "run again with --debug, and leave out the stage that was running; in a sweep, the other runs go on "
                "with --executor processes"
            )
            message = f"a native library crashed ({name}){doing}"
            return self._failed(NativeCrash(message, hint=hint, **place), NativeCrash.exit_code)
        # killed from outside: the run is as good as interrupted, and can go on
        self._tidy_up("interrupted", None)
        if number in ENDING and self._signals:  # both were asked to end, and the child had no handler yet
            self._notify(self._exit_message)
            return 128 + self._signals[0]
        cause = ", perhaps because memory ran out" if number == signal.SIGKILL else ""
        self._notify(f"the process was ended by {name}{cause}{doing}; the same command again goes on where it was")
        return 128 + number

    def _failed(self, error: SppmError, code: int) -> int:
        self._tidy_up("failed", error)
        self._notify(str(error))
        return code

    def _end_orphans(self) -> None:
        """End what the child has left behind, which this process has adopted where the system lets us adopt it."""
        until, left = time.monotonic() + ORPHANS, False
        while True:
            try:
                while os.waitpid(-1, os.WNOHANG)[0]:
                    pass
            except ChildProcessError:
                break
            if time.monotonic() > until + ORPHANS:
                break  # it waits for a device
            if time.monotonic() > until or self._signals:
                left = True
                signal_below(os.getpid(), signal.SIGKILL)
            time.sleep(0.01)
        if left and not self._signals:
            self._notify("a process that was left behind was ended")

    def _wait(self, deadline: float | None, known: int) -> int | None:
        """The child's status when it has ended; None at a deadline, or when more signals than those known have come."""
        while True:
            pid, status = os.waitpid(self._child, os.WNOHANG)
            self._read()
            if pid:
                return status
            if len(self._signals) > known:
                return None
            left = (min(activity.deadlines()) if deadline is None else deadline) - time.monotonic()
            if left <= 0 or (deadline is None and self._takes_too_much()):
                return None
            self._report_slow_import()
            select.select(self._listening, [], [], min(left, LOOK))
            with contextlib.suppress(BlockingIOError):
                os.read(self._wake, 4096)

    def _takes_too_much(self) -> bool:
        """True if the child and all below it hold more memory than they may."""
        if (limit := activity.memory_limit()) == math.inf:
            return False
        # compared twice a second: a stage that takes gigabytes in a moment is ended a moment later
        held = resident_below(self._child)
        if held > limit:
            self._memory = held
        return held > limit

    def _report_slow_import(self) -> None:
        """Say once of each plugin that its import takes long."""
        begun = activity.deadlines()[1] - import_seconds()
        if not SLOW_IMPORT < time.monotonic() - begun < math.inf:
            return
        now = activity.current()
        if now is not None and now.kind == "import" and now.what not in self._slow:
            self._slow.add(now.what)
            self._notify(f"still importing: {now.what.removeprefix('the import of ')}")

    def _read(self) -> None:
        """Take in what the child reports of its run directories."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._reader, 4096):
                self._reported += data
            self._listening = [self._wake]  # the child has closed its end

    def _tidy_up(self, status: str, error: SppmError | None) -> None:
        """Put the run directories in order that the child can't any more."""
        for name in self._reported.split(b"\0"):
            if name:
                self._mark_ended(Path(os.fsdecode(name)), status, error)


def _announce_runs(writer: int) -> None:
    """Report each run directory that is written to to the parent."""

    def announce(path: Path) -> None:
        with contextlib.suppress(OSError):
            os.write(writer, os.fsencode(path.absolute()) + b"\0")

    interruption.on_register(announce)
