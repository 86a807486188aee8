"""Stages that note when they run."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.stage import Context, Recipe, Stage, option


@dataclass(frozen=True, eq=False)
class Numbers(Artifact):
    """Some numbers."""

    values: NDArray[np.float64]

    def summary(self) -> dict[str, Any]:
        return {"sum": float(self.values.sum())}


@dataclass(frozen=True, eq=False)
class Closed(Artifact):
    """An artifact that can't be written."""

    function: Any


N = TypeVar("N", bound=Numbers)


def ran(context: Context) -> None:
    with Path(os.environ["RAN"]).open("a") as file:
        file.write(f"{context.address}\n")


@dataclass(frozen=True, kw_only=True)
class Draw(Stage):
    """Draw numbers."""

    name: ClassVar[str] = "sample.draw"
    count: int = option(1000, help="how many", minimum=1)

    def run(self, context: Context) -> Numbers:
        ran(context)
        return Numbers(context.rng().random(self.count))


@dataclass(frozen=True, kw_only=True)
class Load(Stage):
    """Read numbers from a file."""

    name: ClassVar[str] = "read.numbers"
    path: Path = option(help="the file")

    def run(self, context: Context) -> Numbers:
        ran(context)
        return Numbers(np.array(self.path.read_text().split(), float))


@dataclass(frozen=True, kw_only=True)
class Shift(Stage):
    """Add to numbers, which is not worth keeping."""

    name: ClassVar[str] = "field.shift"
    by: float = option(1.0, help="how much")

    def run(self, context: Context, numbers: Numbers) -> Numbers:
        ran(context)
        return Numbers(numbers.values + self.by)


@dataclass(frozen=True, kw_only=True)
class Look(Stage):
    """Pass numbers on, with a warning."""

    name: ClassVar[str] = "check.look"

    def run(self, context: Context, numbers: N) -> N:
        ran(context)
        context.warn("these are numbers")
        context.report(largest=numbers.values.max())
        return numbers


@dataclass(frozen=True, kw_only=True)
class Again(Stage):
    """Repeat a recipe."""

    name: ClassVar[str] = "tune.again"
    times: int = option(2, help="how often")

    def run(self, context: Context, recipe: Recipe) -> Any:
        ran(context)
        return [recipe.run(context, attempt=i) for i in range(self.times)][-1]


@dataclass(frozen=True, kw_only=True)
class Clock(Stage):
    """Something that is different every time."""

    name: ClassVar[str] = "read.clock"
    cacheable: ClassVar[bool] = False

    def run(self, context: Context) -> Numbers:
        ran(context)
        return Numbers(np.array([float(time.time_ns())]))


@dataclass(frozen=True, kw_only=True)
class Close(Stage):
    """Make an artifact that can't be kept."""

    name: ClassVar[str] = "fill.closed"

    def run(self, context: Context, numbers: Numbers) -> Closed:
        ran(context)
        total = float(numbers.values.sum())
        return Closed(lambda: total)


@dataclass(frozen=True, kw_only=True)
class WriteNumbers(Stage):
    """Write numbers as a file and as a folder of files."""

    name: ClassVar[str] = "write.numbers"
    path: str = option("numbers", help="name of the output")

    def run(self, context: Context, source: Numbers | Closed) -> None:
        ran(context)
        values = source.values if isinstance(source, Numbers) else np.array([source.function()])
        context.output(f"{self.path}.txt").write_text("\n".join(map(repr, values.tolist())))
        folder = context.output(self.path)
        (folder / "deep").mkdir(parents=True)
        for i, value in enumerate(values[:5]):
            (folder / "deep" / f"{i}.txt").write_text(repr(float(value)))
        context.report(written=len(values))
