"""The exception tree. Every error a user can cause derives from `SppmError` and has an exit code.

::

    SppmError
    ├── ConfigError         2   the YAML file or the command line is wrong
    │   └── WiringError     2   the stages do not fit together
    ├── InputError          3   an input file can't be used (a broken mesh, a truncated image)
    ├── DesignError         3   a design can't be satisfied (impossible packing, unreachable porosity, no valid draw)
    ├── PluginError         4   a plugin failed to load, or broke its contract
    ├── ResourceError       5   disk, memory or a permission is missing
    └── NativeCrash         6   a native library died
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass


def harmless(text: str) -> str:
    """A text without what a terminal would obey: control characters, and marks that turn the order of letters round."""
    return "".join(char if char in "\n\t" or char.isprintable() else ascii(char)[1:-1] for char in text)


def text_of(error: BaseException) -> str:
    """The text of an exception of foreign code, which may raise or hold escape sequences."""
    try:
        return harmless(str(error))
    except Exception as second:
        return f"(no text: its __str__ raised {harmless(type(second).__name__)})"


def described(error: BaseException) -> str:
    """Type and text of an exception of foreign code."""
    return f"{harmless(type(error).__name__)}: {text_of(error)}"


@dataclass(frozen=True)
class Position:
    """A place in a text file; line and column count from 1. Line 0 stands for a place that is in no file."""

    file: str
    line: int
    column: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


class SppmError(Exception):
    """Base of all errors that a user can cause or fix.

    Parameters
    ----------
    message : str
        What is wrong: the value, what is allowed.
    hint : str, optional
        What to do next; printed on a line of its own.
    where : Position, optional
        The place in the configuration. The engine fills it in for errors raised inside a stage.
    stage : str, optional
        The id of the stage. The engine fills it in.
    """

    exit_code = 1

    def __init__(
        self, message: str, *, hint: str | None = None, where: Position | None = None, stage: str | None = None
    ) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.where = where
        self.stage = stage

    def __str__(self) -> str:
        place = f"{self.where}: " if self.where else ""
        stage = f"stage {self.stage!r}: " if self.stage else ""
        hint = f"\n  hint: {self.hint}" if self.hint else ""
        return f"{place}{stage}{self.message}{hint}"


class ConfigError(SppmError):
    """The configuration or the command line is wrong."""

    exit_code = 2


class ConfigErrors(ConfigError):
    """Several configuration errors found in one pass, reported together, in the order of the file."""

    def __init__(self, errors: Sequence[SppmError]) -> None:
        if not errors:
            raise ValueError("ConfigErrors needs at least one error")
        super().__init__(f"{len(errors)} error(s)")
        self.errors = tuple(errors)

    def __str__(self) -> str:
        # a hint that several errors in a row share stands below the last of them
        following = [error.hint for error in self.errors[1:]]
        return "\n".join(
            str(error).removesuffix(f"\n  hint: {error.hint}") if error.hint == then else str(error)
            for error, then in zip(self.errors, [*following, None], strict=True)
        )


class WiringError(ConfigError):
    """A stage needs an input that no earlier stage makes, or more than one reading is possible."""


class InputError(SppmError):
    """An input file can't be used."""

    exit_code = 3


class DesignError(SppmError):
    """The design can't be satisfied; the message names the best that was reached."""

    exit_code = 3


class PluginError(SppmError):
    """A plugin failed to load, raised, or broke its contract."""

    exit_code = 4


class ResourceError(SppmError):
    """Disk, memory or a permission is missing."""

    exit_code = 5


class NativeCrash(SppmError):
    """A native library died by a signal."""

    exit_code = 6


def listed(words: Iterable[str], conjunction: str = "and") -> str:
    """``'a', 'b' and 'c'``."""
    quoted = [repr(word) for word in words]
    if len(quoted) < 2:
        return "".join(quoted)
    return f"{', '.join(quoted[:-1])} {conjunction} {quoted[-1]}"


def near_names(word: str, known: Iterable[str]) -> list[str]:
    """Up to three of `known` that `word` may stand for: but for case, as a part of dotted ones, or misspelled."""
    from difflib import get_close_matches

    names, lower = sorted(set(known)), word.lower()
    near = [name for name in names if name.lower() == lower]
    near = near or [name for name in names if f".{lower}." in f".{name.lower()}."]
    # 0.6 is the default of difflib; not sensitive: only which hint is given
    near = near or get_close_matches(word, names, 3, 0.6)
    # a forgotten or wrong family: dart_throwing for sample.dart_throwing
    last = lower.rpartition(".")[2]
    return (near or [name for name in names if name.lower().rpartition(".")[2] == last])[:3]


def meant(names: Sequence[str]) -> str:
    """The hint that names what may be meant."""
    return f"did you mean {listed(names, 'or')}?"


MAX_NAMED = 20
"""Names that a hint lists where none is near."""


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """A hint that names the nearest of `known`, or else the first of them; None if there are none."""
    names = sorted(set(known))
    if near := near_names(word, names):
        return meant(near)
    more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
    return f"known: {', '.join(names[:MAX_NAMED])}{more}" if names else None
