"""Calling a function in a child process, and waiting for it whatever it does; the package says what is promised."""

from __future__ import annotations

import contextlib
import json
import math
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from numpy.typing import NDArray

from sppm_pipeline import errors
from sppm_pipeline.engine.process.budget import child_memory
from sppm_pipeline.engine.process.exchange import LONGEST_LINE, ArraySpec, private_folder, read_arrays, write_arrays
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, SppmError

KEPT_OUTPUT = 16_384
"""Bytes of output that are kept; the rest is read and dropped, so that the child neither waits nor fills our memory."""

PATIENCE = 10.0
"""Seconds that the supervisor gets to end the worker and all that descends from it."""

POLL = 0.2
"""Longest time in seconds after which a call to `stop_all` is noticed."""

_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS",
)  # fmt: skip
"""Environment variables of thread pools."""

_SCRIPTS = Path(__file__).parent
_running: set[threading.Event] = set()
_running_lock = threading.Lock()


class NativeResult(NamedTuple):
    """Result of the child.

    Attributes
    ----------
    arrays : dict of str to array
        As specified: dtype, shape, finite.
    values : dict
        JSON values.
    """

    arrays: dict[str, NDArray[Any]]
    values: dict[str, Any]


def run_native(
    function: str,
    arrays: Mapping[str, NDArray[Any]],
    options: Mapping[str, Any] | None = None,
    *,
    returns: Mapping[str, ArraySpec],
    distribution: str,
    seconds: float,
    memory: int | None = None,
    threads: int = 1,
    hint: str | None = None,
    progress: Callable[[float, float, str], object] | None = None,
) -> NativeResult:
    """Call a function in a fresh interpreter, so that it may crash or hang.

    The function is called as ``function(arrays, options)`` and returns two dicts: the arrays that were specified, and
    JSON values. It works in an empty private folder, which is removed afterwards. It may call `notify` to report the
    step it is at. What it prints is not shown, but its last lines are part of an error.

    Parameters
    ----------
    function : str
        ``"package.module:name"``, importable with the caller's ``sys.path``.
    arrays : mapping of str to array
        Arrays of numbers, handed over as .npy files.
    options : mapping of str, optional
        JSON values.
    returns : mapping of str to ArraySpec
        The arrays that the function has to return.
    distribution : str
        Whose code it is; named with its version when it fails.
    seconds : float
        Wall time after which the child is ended.
    memory : int, optional
        Bytes that the child, and each process it starts, may use; by default what is available (`budget`).
    threads : int
        What the usual variables of thread pools (``OMP_NUM_THREADS``...) are set to.
    hint : str, optional
        What the user can do when the library crashes or runs out of time.
    progress : callable, optional
        Called here as ``progress(done, total, step)`` for what the function reported; `Context.progress` fits.

    Returns
    -------
    NativeResult

    Raises
    ------
    NativeCrash
        If the child died by a signal.
    ResourceError
        If it used up its time or its memory (the system killing it counts as such), or could not be started. Time is a
        resource as memory is: the same input may well succeed with more of it.
    PluginError
        If the function raised, ended its process, or returned something else than was specified.
    SppmError
        What the function raised itself, if it is an `SppmError`; class, message and hint are kept.
    ValueError
        If `arrays`, `options` or a limit make no sense.
    """
    module, colon, name = function.partition(":")
    if not (colon and all(part.isidentifier() for part in [*module.split("."), name])):
        raise ValueError(f"expected 'package.module:function', got {function!r}")
    if not (seconds > 0 and math.isfinite(seconds)):
        raise ValueError(f"the time limit must be a positive number of seconds, got {seconds}")
    if memory is not None and memory <= 0:
        raise ValueError(f"the memory limit must be positive, got {memory}")
    if sys.platform == "win32":
        raise ResourceError(
            f"{distribution} runs in a child process that only Linux and macOS can keep in check",
            hint="run the program under the Windows Subsystem for Linux",
        )
    task = Task(distribution, seconds, memory or child_memory(), hint)
    try:
        with private_folder() as folder:
            _write_job(folder, function, arrays, options or {}, returns, task.memory)
            termination = _wait(folder, task, child_environment(os.environ, folder / "work", threads), progress)
            values = outcome_of(termination, task, folder / "outcome.json")
            try:
                return NativeResult(read_arrays(folder / "returned", returns), values)
            except ValueError as error:
                raise error_of(PluginError, termination, task, f"returned something unusable: {error}") from None
    except OSError as error:
        raise ResourceError(f"{distribution} can't be run in a child process: {error.strerror or error}") from error


def stop_all() -> None:
    """End all children of this process; each `run_native` under way raises `ResourceError`.

    For a program that is interrupted while children run in other threads: only the main thread gets signals.
    """
    with _running_lock:
        for event in _running:
            event.set()


def _write_job(
    folder: Path,
    function: str,
    arrays: Mapping[str, NDArray[Any]],
    options: Mapping[str, Any],
    returns: Mapping[str, ArraySpec],
    memory: int,
) -> None:
    for name in ("arrays", "work"):
        (folder / name).mkdir()
    write_arrays(folder / "arrays", arrays)
    path = [os.path.abspath(entry) for entry in sys.path]
    job = {"function": function, "arrays": sorted(arrays), "options": dict(options), "returns": sorted(returns)}
    try:
        text = json.dumps({**job, "memory": memory, "path": path}, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"the options must be JSON values: {error}") from None
    (folder / "job.json").write_text(text, encoding="utf-8")


def child_environment(inherited: Mapping[str, str], folder: Path, threads: int) -> dict[str, str]:
    """The environment of the child: that of the parent, with everything pinned that could change a result."""
    return {
        **inherited,
        **dict.fromkeys(_THREADS, str(threads)),
        "OMP_DYNAMIC": "false",
        "LC_ALL": "C.UTF-8",  # many a reader of numbers fails at a decimal comma
        "PYTHONUTF8": "1",
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",  # what was printed before a crash has to be in the message
        "TMPDIR": str(folder),
    }


@contextlib.contextmanager
def _child(folder: Path, environment: Mapping[str, str], progress: int) -> Iterator[subprocess.Popen[bytes]]:
    """The supervisor with the worker below it; both are gone afterwards."""
    import psutil

    process = subprocess.Popen(
        [
            *(sys.executable, "-P", "-S", str(_SCRIPTS / "supervisor.py")),
            *(str(os.getpid()), str(progress), str(_SCRIPTS / "worker.py"), str(folder)),
            str(Path(psutil.__file__).parents[1]),
        ],
        cwd=folder / "work",
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        # its own session: the signals of the terminal must not reach the child
        start_new_session=True,  # this process handles a Ctrl-C in the terminal
        pass_fds=(progress,),
    )
    assert process.stdin is not None
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        yield process
    finally:
        process.stdin.close()  # the supervisor then ends them all
        try:
            process.wait(PATIENCE)
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
            process.stderr.close()


def _wait(
    folder: Path,
    task: Task,
    environment: Mapping[str, str],
    progress: Callable[[float, float, str], object] | None,
) -> Termination:
    """Run the child to its end, or to that of its time."""
    deadline = time.monotonic() + task.seconds
    stop = threading.Event()
    reports, report = os.pipe()
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, reports)
        with _running_lock:
            _running.add(stop)
        stack.callback(_running.discard, stop)
        try:
            process = stack.enter_context(_child(folder, environment, report))
        finally:
            os.close(report)
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        received = {process.stdout.fileno(): bytearray(), process.stderr.fileno(): bytearray(), reports: bytearray()}
        status, output, lines = received.values()
        selector = stack.enter_context(selectors.DefaultSelector())
        for pipe in received:
            os.set_blocking(pipe, False)
            selector.register(pipe, selectors.EVENT_READ)
        step, ended_by = "", ""
        # the end of the status is the end of the supervisor, and it ends last; others may hold pipes open for longer
        while process.stdout.fileno() in selector.get_map():
            left = deadline - time.monotonic()
            if not ended_by and (left <= 0 or stop.is_set()):
                ended_by = "stop" if left > 0 else "time"
                process.stdin.close()
                deadline = time.monotonic() + PATIENCE
            elif ended_by and left <= 0:
                break
            for key, _ in selector.select(max(0.0, min(POLL, left))):
                _drain(selector, key.fd, received[key.fd])
            step = _last_step(lines, progress if not ended_by else None) or step
            del output[:-KEPT_OUTPUT]
        for pipe, data in received.items():
            if pipe in selector.get_map():
                _drain(selector, pipe, data)
        step = _last_step(lines, None) or step
    ended_by = ended_by or bytes(status).decode("ascii", "replace").strip()
    return Termination(ended_by, step, bytes(output[-KEPT_OUTPUT:]))


def _drain(selector: selectors.BaseSelector, pipe: int, into: bytearray) -> None:
    """Read what there is, up to an amount that lets the others have their turn."""
    with contextlib.suppress(BlockingIOError):
        data = os.read(pipe, 1 << 16)
        into += data
        if not data:
            selector.unregister(pipe)


def _last_step(lines: bytearray, progress: Callable[[float, float, str], object] | None) -> str:
    """Take the complete lines of progress; the last step, or nothing. Anything else in the pipe is skipped."""
    step = ""
    while (end := lines.find(b"\n")) >= 0:
        line = bytes(lines[:end])
        del lines[: end + 1]
        if len(line) > LONGEST_LINE:
            continue
        try:
            what, done, total = json.loads(line)
            done, total = float(done), float(total)
        except (ValueError, TypeError):
            continue
        if isinstance(what, str) and math.isfinite(done) and math.isfinite(total):
            step = what
            if progress is not None and total > 0:
                progress(done, total, what)
    del lines[: -LONGEST_LINE - 1]
    return step


E = TypeVar("E", bound=SppmError)

_SHOWN_LINES, _SHOWN_WIDTH = 8, 160

_NO_MEMORY = (b"bad_alloc", b"annot allocate memory", b"ut of memory", b"MemoryError", b"bad allocation")
"""Messages of libraries that give up without memory."""


class Task(NamedTuple):
    """Parts of a call that messages name."""

    distribution: str
    seconds: float
    memory: int
    hint: str | None

    @property
    def who(self) -> str:
        """Distribution and version."""
        from importlib.metadata import PackageNotFoundError, version

        try:
            return f"{self.distribution} {version(self.distribution)}"
        except PackageNotFoundError:
            return self.distribution


class Termination(NamedTuple):
    """End of the child, with the last `step` that was reported and the end of the `output`.

    `how` is an exit code in decimal digits, negative for a signal, "time" for the limit, "stop" for `stop_all`, and
    empty if the supervisor was killed.
    """

    how: str
    step: str
    output: bytes


def error_of(kind: type[E], termination: Termination, task: Task, what: str, hint: str | None = None) -> E:
    """An error that names the distribution, the step and the last lines of output."""
    step = f" in step {termination.step!r}" if termination.step else ""
    return kind(f"{task.who} {what}{step}{_last_lines(termination.output)}", hint=hint)


def outcome_of(termination: Termination, task: Task, path: Path) -> dict[str, Any]:
    """The values that the function returned; raises the fitting exception if there are none."""
    if termination.how == "time":
        raise error_of(ResourceError, termination, task, f"used up its {task.seconds:g} s", task.hint or _MORE_TIME)
    if termination.how == "stop":
        raise error_of(ResourceError, termination, task, "was stopped, as the program was interrupted")
    if termination.how.startswith("-"):
        raise _crash(termination, task, int(termination.how[1:]))
    try:
        outcome = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        outcome = None
    if termination.how != "0" or not isinstance(outcome, dict):
        code = f" with exit code {termination.how}" if termination.how else ""
        raise error_of(PluginError, termination, task, f"ended{code} without a result", task.hint)
    if "memory" in outcome:
        raise _memory(termination, task)
    if "known" in outcome:
        kind = getattr(errors, outcome["known"])
        if kind is errors.ConfigErrors:
            kind = errors.ConfigError
        raise kind(outcome["message"], hint=outcome["hint"])
    if "module" in outcome:
        hint = f"install it: pip install {task.distribution}"
        raise PluginError(f"{task.who} needs the module {outcome['module']!r}, which can't be imported", hint=hint)
    if "raised" in outcome:
        raised = "" if outcome["raised"] == "SystemExit" else f"raised {outcome['raised']}: "
        what = raised + outcome["message"]
        raise error_of(PluginError, termination, task, what, task.hint)
    values = outcome["values"]
    assert isinstance(values, dict)
    return values


_MORE_TIME = "give it more time, or a coarser input"
_CRASH_HINT = "nothing else was harmed; check the input (closed, no degenerate triangles), or give other options"


def _crash(termination: Termination, task: Task, number: int) -> SppmError:
    # libraries abort when an allocation fails, which looks like a crash
    if any(words in termination.output for words in _NO_MEMORY):
        return _memory(termination, task)
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
    if number == signal.SIGKILL:
        what = "was killed from outside (SIGKILL); systems do that when memory runs out"
        return error_of(ResourceError, termination, task, what, "use a coarser input, or a machine with more memory")
    words = signal.strsignal(number)
    described = f"{name} ({words[0].lower()}{words[1:]})" if words else name
    return error_of(NativeCrash, termination, task, f"died by {described}", task.hint or _CRASH_HINT)


def _memory(termination: Termination, task: Task) -> ResourceError:
    what = f"ran out of memory; its limit was {task.memory / 2**30:.3g} GiB"
    return error_of(ResourceError, termination, task, what, "use a coarser input, or a machine with more memory")


def _last_lines(output: bytes) -> str:
    """The last lines, without control characters."""
    text = output.decode("utf-8", "replace").replace("\r", "\n")
    lines = [
        "".join(c if c.isprintable() else "?" for c in line.rstrip().replace("\t", " "))[:_SHOWN_WIDTH]
        for line in text.split("\n")
        if line.strip()
    ]
    return "".join(f"\n  its output: {line}" for line in lines[-_SHOWN_LINES:])
