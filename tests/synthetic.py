"""Stages and artifacts without geometry, for tests of the engine, of executors and of tools around runs.

They register through the hooks like any plugin: ``--plugin`` or `load_plugins(["tests.synthetic"])`.
"""

from __future__ import annotations

import errno
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.table import Table
from sppm_pipeline.stage import Context, Recipe, Rejected, Stage, option

N = TypeVar("N", bound="Number")


@dataclass(frozen=True)
class Number(Artifact):
    """A number. Not a number contradicts itself."""

    value: float

    def summary(self) -> dict[str, Any]:
        """The value."""
        return {"value": self.value}

    def check(self) -> None:
        """It equals itself."""
        if self.value != self.value:
            raise ValueError("not a number")


@dataclass(frozen=True)
class Whole(Number):
    """A number of a narrower kind."""


@dataclass(frozen=True)
class Text(Artifact):
    """A string."""

    text: str


@dataclass(frozen=True, kw_only=True)
class ReadNumber(Stage):
    """Make a number."""

    name: ClassVar[str] = "read.number"

    value: float = option(help="the number", minimum=-1e6, maximum=1e6)

    def run(self, context: Context) -> Number:
        """Make it."""
        return Number(self.value)


@dataclass(frozen=True, kw_only=True)
class ReadWhole(Stage):
    """Make an integer."""

    name: ClassVar[str] = "read.whole"

    value: int = option(3, help="the number")

    def run(self, context: Context) -> Whole:
        """Make it."""
        return Whole(self.value)


@dataclass(frozen=True, kw_only=True)
class RandomNumber(Stage):
    """Draw a number, on top of another if there is one."""

    name: ClassVar[str] = "sample.random"

    count: int = option(1, help="how many are drawn and added", minimum=1, maximum=1000)

    def run(self, context: Context, base: Number | None) -> Number:
        """Draw."""
        drawn = context.rng().random(self.count)
        context.report(count=self.count, first=drawn[0], interiors=context.palette.interiors)
        return Number(float(drawn.sum()) + (base.value if base is not None else 0.0))


@dataclass(frozen=True, kw_only=True)
class ScaleNumber(Stage):
    """Multiply a number."""

    name: ClassVar[str] = "field.scale"

    factor: float = option(2.0, help="what it is multiplied by", above=0)

    def run(self, context: Context, number: Number) -> Number:
        """Multiply."""
        context.progress(1, 1, "numbers")
        return Number(number.value * self.factor)


@dataclass(frozen=True, kw_only=True)
class AddNumbers(Stage):
    """Add two numbers."""

    name: ClassVar[str] = "fill.sum"

    def run(self, context: Context, left: Number, right: Number) -> Number:
        """Add."""
        return Number(left.value + right.value)


@dataclass(frozen=True, kw_only=True)
class TotalNumbers(Stage):
    """Add one number or more."""

    name: ClassVar[str] = "fill.total"

    def run(self, context: Context, numbers: tuple[Number, ...]) -> Number:
        """Add."""
        return Number(sum(number.value for number in numbers))


@dataclass(frozen=True, kw_only=True)
class LimitNumber(Stage):
    """Reject a number that is too large, else pass it on as what it is."""

    name: ClassVar[str] = "check.limit"

    maximum: float = option(0.5, help="the largest that is accepted")
    soft: bool = option(False, help="warn, and accept it")

    def run(self, context: Context, number: N) -> N:
        """Compare."""
        if number.value > self.maximum:
            if not self.soft:
                raise Rejected(f"{number.value:g} is larger than {self.maximum:g}")
            context.warn(f"larger than {self.maximum:g}")
        return number


@dataclass(frozen=True, kw_only=True)
class ToText(Stage):
    """Write a number as a string."""

    name: ClassVar[str] = "extract.text"

    def run(self, context: Context, number: Number) -> Text:
        """Convert."""
        return Text(f"{number.value!r}")


@dataclass(frozen=True, kw_only=True)
class Repeat(Stage):
    """Run a recipe until no check rejects what it makes."""

    name: ClassVar[str] = "tune.repeat"

    attempts: int = option(20, help="most draws", minimum=1)
    target: str = option("", help="a stage of the recipe whose option is changed; none if empty")
    option_name: str = option("", help="the option")
    value: float = option(0.0, help="its value")

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Draw until accepted."""
        options = {self.target: {self.option_name: self.value}} if self.target else None
        for attempt in range(self.attempts):
            try:
                made = recipe.run(context, attempt=attempt, options=options)
            # the attempt is part of the generators' path, so that the next draw is another one
            except Rejected:
                continue
            context.report(attempts=attempt + 1)
            return made
        raise DesignError(f"none of {self.attempts} draws was accepted")


@dataclass(frozen=True, kw_only=True)
class WriteNumber(Stage):
    """Write a number or a string as a file."""

    name: ClassVar[str] = "write.number"

    path: str = option("number.txt", help="file to write", output=True)

    def run(self, context: Context, source: Number | Text) -> None:
        """Write."""
        text = source.text if isinstance(source, Text) else repr(source.value)
        context.output(self.path).write_text(f"{text}\n", encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class WriteTable(Stage):
    """Write the sum of a column of a sweep."""

    name: ClassVar[str] = "write.column"

    column: str = option(help="name of the column")
    path: str = option("sum.txt", help="file to write", output=True)

    def run(self, context: Context, table: Table) -> None:
        """Add and write."""
        # runs that failed leave a gap
        total = sum(value for value in table.columns[self.column] if value is not None)
        context.report(total=total, rows=table.rows)
        context.output(self.path).write_text(f"{total!r}\n", encoding="utf-8")


@dataclass(frozen=True, kw_only=True)
class Varied(Stage):
    """An option of each type; makes the text of all of them."""

    name: ClassVar[str] = "read.varied"

    flag: bool = option(False, help="a truth value")
    whole: int = option(1, help="an integer", minimum=0, maximum=10)
    number: float = option(0.5, help="a number", above=0, below=1)
    word: str = option("one", help="a word", choices=("one", "two", "three"))
    text: str = option("", help="any string")
    file: Path | None = option(None, help="an input file")
    length: Length = option(Length(1.0), help="a length", unit="mm", above=0, maximum=100)
    pair: tuple[int, int] = option((3, 5), help="two integers", minimum=1)
    numbers: tuple[float, ...] = option((), help="numbers", minimum=-1)
    maybe: int | None = option(None, help="an integer or nothing")
    either: int | tuple[int, int, int] = option(1, help="one number or three", minimum=1)
    sizes: tuple[Length, Length] | None = option(None, help="two lengths")

    def check_options(self) -> None:
        """The pair is in order."""
        if self.pair[0] > self.pair[1]:
            raise ConfigError(f"the pair {self.pair} must be in order")

    def run(self, context: Context) -> Text:
        """Show them."""
        return Text(repr(self))


@dataclass(frozen=True, kw_only=True)
class Failing(Stage):
    """Fail in a chosen way."""

    name: ClassVar[str] = "check.fail"

    how: str = option(
        "value",
        help="what goes wrong",
        choices=("value", "design", "memory", "disk", "missing", "wrong_type", "inconsistent", "no_output", "escape",
                 "bad_report", "interrupt"),
    )  # fmt: skip

    def run(self, context: Context, number: Number | None) -> Number:
        """Fail."""
        match self.how:
            case "value":
                raise ValueError("this stage always fails")
            case "design":
                raise DesignError("impossible", hint="give up")
            case "memory":
                raise MemoryError
            case "disk":
                raise OSError(errno.ENOSPC, "No space left on device", "big.bin")
            case "missing":
                raise FileNotFoundError(errno.ENOENT, "No such file or directory", "in.stl")
            case "wrong_type":
                return Text("no number")  # type: ignore[return-value]
            case "inconsistent":
                return Number(float("nan"))
            case "no_output":
                context.output("never.txt")
            case "escape":
                context.output("../outside.txt")
            case "bad_report":
                context.report(thing=object())
            case "interrupt":
                context.output("half.txt").write_text("half", encoding="utf-8")
                signal.raise_signal(signal.SIGINT)
                for _ in range(1000):  # a run in a thread of its own notices when it next reports something
                    context.progress(0, 1, "waiting to be interrupted")
                    time.sleep(0.01)
        return Number(0.0)


@hookimpl
def sppm_stages() -> dict[str, type[Stage]]:
    """All stages of this module."""
    classes: list[type[Stage]] = [
        ReadNumber, ReadWhole, RandomNumber, ScaleNumber, AddNumbers, TotalNumbers, LimitNumber, ToText, Repeat,
        WriteNumber, WriteTable, Varied, Failing,
    ]  # fmt: skip
    return {cls.name: cls for cls in classes}
