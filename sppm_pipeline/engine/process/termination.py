"""Termination of a native child: its result, or the exception that fits, with a message."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from sppm_pipeline import errors
from sppm_pipeline.errors import NativeCrash, PluginError, ResourceError, SppmError

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
