"""The contracts accept stages that keep them and refuse those that do not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, WiringError
from sppm_pipeline.method.families.interiors import InteriorBox
from sppm_pipeline.method.families.sampler import Sampler
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.slicing.slice_stack import ArraySlices, SliceStack
from sppm_pipeline.stage import Context, Stage, option
from sppm_pipeline.testing.contracts import SamplerContract, SlicerContract, StageContract
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of
from tests.synthetic import (
    LimitNumber,
    Number,
    RandomNumber,
    ReadWhole,
    Repeat,
    ScaleNumber,
    Varied,
    Whole,
    WriteNumber,
)


@dataclass(frozen=True, kw_only=True)
class Uniform(Sampler):
    """Independent uniform pores."""

    name: ClassVar[str] = "sample.uniform"
    count: int = option(5, help="pores of an interior", minimum=1)

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> Any:
        return box.lower + rng.random((self.count, 3)) * (box.upper - box.lower)


class TestUniform(SamplerContract):
    def stages(self):
        return [Uniform(), Uniform(count=1)]


CALLS: list[float] = []


def powers(number: Number, exponents: np.ndarray) -> np.ndarray:
    """What a worker does with an item."""
    return number.value**exponents


def counted(number: Number, exponents: np.ndarray) -> np.ndarray:
    """The same by one that remembers."""
    CALLS.append(1.0)
    return number.value**exponents + len(CALLS)


@dataclass(frozen=True, kw_only=True)
class Powers(Stage):
    """Report powers of a number, each found by a worker."""

    name: ClassVar[str] = "check.powers"
    work: ClassVar[Any] = staticmethod(powers)

    def run(self, context: Context, number: Number) -> None:
        items = [np.arange(n) for n in range(1, 4)]
        context.report(sums=[float(made.sum()) for made in context.map(self.work, items, number)])


@dataclass(frozen=True, kw_only=True)
class Remembering(Powers):
    """By workers that remember what they did."""

    work: ClassVar[Any] = staticmethod(counted)


@dataclass(frozen=True, kw_only=True)
class Handmade(Powers):
    """By a function that workers can't find."""

    work: ClassVar[Any] = staticmethod(lambda number, exponents: number.value**exponents)


class TestPowers(StageContract):
    def stages(self):
        return [Powers()]

    def inputs(self) -> Mapping[str, Any]:
        return {"number": Number(2.0)}


@pytest.mark.parametrize(("stage", "error"), [(Remembering(), AssertionError), (Handmade(), TypeError)])
def test_what_workers_can_not_do_again_is_refused(stage, error):
    class Suite(TestPowers):
        def stages(self):
            return [stage]

    with pytest.raises(error):
        Suite().test_same_seed_same_result()


class TestRandomNumber(StageContract):
    def stages(self):
        return [RandomNumber(), RandomNumber(count=3)]


class TestScale(StageContract):
    def stages(self):
        return [ScaleNumber()]

    def inputs(self) -> Mapping[str, Any]:
        return {"number": Number(2.0)}


class TestWrite(TestScale):
    def stages(self):
        return [WriteNumber(), WriteNumber(path="deep/x.txt")]

    def inputs(self) -> Mapping[str, Any]:
        return {"source": Number(2.0)}


class TestVaried(StageContract):
    def stages(self):
        return [Varied(), Varied(pair=(7, 9), either=(1, 2, 3), maybe=3)]


class TestRepeat(StageContract):
    def stages(self):
        return [Repeat(attempts=500)]

    def inputs(self) -> Mapping[str, Any]:
        return {"recipe": recipe_of(RandomNumber(), LimitNumber(maximum=0.2))}


@dataclass(frozen=True, kw_only=True)
class Careless(Uniform):
    """Draws from the global generator."""

    name: ClassVar[str] = "sample.careless"

    def throw(self, rng: np.random.Generator, box: InteriorBox) -> Any:
        return np.random.random((self.count, 3))  # noqa: NPY002


@dataclass(frozen=True, kw_only=True)
class Threaded(Uniform):
    """Depends on the number of threads."""

    name: ClassVar[str] = "sample.threaded"

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        context.report(threads=context.threads)
        return super().run(context, pores)


@dataclass(frozen=True, kw_only=True)
class Stubborn(Uniform):
    """Throws one interior, whatever is asked for."""

    name: ClassVar[str] = "sample.stubborn"

    def run(self, context: Context, pores: PoreSet | None) -> PoreSet:
        return Uniform(count=self.count).run(PlainContext(context.rng().integers(1 << 30)), None)


@dataclass(frozen=True, kw_only=True)
class Liar(Stage):
    """Makes something else."""

    name: ClassVar[str] = "Check.Liar"
    path: str = option("x", help="")

    def run(self, context: Context) -> Whole:
        return Number(1)  # type: ignore[return-value]


@dataclass(frozen=True, kw_only=True)
class Vandal(Stage):
    """Changes what it is given."""

    name: ClassVar[str] = "check.vandal"

    def run(self, context: Context, number: Number) -> None:
        object.__setattr__(number, "value", number.value + 1)


@dataclass(frozen=True, kw_only=True)
class Steps(Stage):
    """Layers of a staircase."""

    name: ClassVar[str] = "slice.steps"
    pixel: float | tuple[float, float] = option((0.2, 0.3), help="pixel pitch", unit="mm", above=0, maximum=10)

    def run(self, context: Context) -> SliceStack:
        pitch = self.pixel if isinstance(self.pixel, tuple) else (self.pixel, self.pixel)
        return self.stack(np.tri(3, 4, dtype=np.uint8)[None].repeat(2, axis=0) * np.uint8(255), (*pitch, 0.1))

    def stack(self, layers: Any, pitch: tuple[float, float, float]) -> SliceStack:
        return ArraySlices(layers, pitch)


class TestSteps(SlicerContract):
    def stages(self):
        return [Steps(), Steps(pixel=0.5)]


@dataclass(frozen=True, eq=False)
class OldSlices(ArraySlices):
    """One number for pixels, and layers in between without saying so."""

    pixel_mm = 0.2
    gray = False


@dataclass(frozen=True, kw_only=True)
class OldSteps(Steps):
    """As stacks were when pixels were square."""

    def stack(self, layers: Any, pitch: tuple[float, float, float]) -> SliceStack:
        return OldSlices(layers // 2, pitch)


@pytest.mark.parametrize(
    ("contract", "stage", "test"),
    [
        (SamplerContract, Careless(), "test_same_seed_same_result"),
        (SamplerContract, Careless(), "test_makes_what_it_announces_and_changes_nothing_else"),
        (SamplerContract, Threaded(), "test_same_seed_same_result"),
        (SamplerContract, Stubborn(), "test_fills_every_interior_that_is_asked_for"),
        (SamplerContract, Stubborn(), "test_keeps_the_pores_that_are_there"),
        (SlicerContract, OldSteps(), "test_pixels_have_a_pitch_along_x_and_one_along_y"),
        (SlicerContract, OldSteps(), "test_layers_come_from_the_bottom_without_a_gap"),
        (StageContract, Liar(), "test_makes_what_it_announces_and_changes_nothing_else"),
        (StageContract, Liar(), "test_has_a_name_of_family_and_word"),
        (StageContract, Liar(), "test_says_what_it_does"),
    ],
)
def test_a_broken_contract_is_noticed(contract, stage, test):
    suite = type("Suite", (contract,), {"stages": lambda self: [stage]})()
    with pytest.raises(AssertionError):
        getattr(suite, test)()


def test_a_changed_input_is_noticed():
    class Suite(TestScale):
        def stages(self):
            return [Vandal()]

    with pytest.raises(AssertionError):
        Suite().test_makes_what_it_announces_and_changes_nothing_else()


def test_outputs_of_a_plain_context(tmp_path):
    context = PlainContext(directory=tmp_path)
    WriteNumber(path="a/b.txt").run(context, Number(1.5))
    assert (tmp_path / "a" / "b.txt").read_text() == "1.5\n"
    with pytest.raises(ConfigError):
        context.output("../x")


def test_a_plain_context_keeps_what_it_was_told():
    context = PlainContext()
    ScaleNumber().run(context, Number(1.0))
    LimitNumber(soft=True).run(context, Number(9.0))
    RandomNumber().run(context, None)
    assert context.progress_calls == [(1, 1, "numbers")]
    assert context.warnings == ["larger than 0.5"]
    assert context.reported["count"] == 1


def test_temporary_outputs_go_with_their_context():
    context = PlainContext()
    directory = context.output("x").parent
    assert directory.is_dir()
    del context
    assert not directory.exists()


def test_recipes_of_stages():
    recipe = recipe_of(ReadWhole(value=4), ScaleNumber(factor=2), ScaleNumber(factor=5))
    assert recipe.run(PlainContext()).value == 40
    assert recipe.run(PlainContext(), options={"field.scale#2": {"factor": 1}}).value == 8
    assert list(recipe.options()) == ["read.whole", "field.scale", "field.scale#2"]
    with pytest.raises(WiringError):
        recipe_of(ScaleNumber())


def test_a_stack_whose_pixels_have_one_number_is_refused_by_the_engine():
    with pytest.raises(ValueError, match=r"pitch along x and y, not 0\.2"):
        OldSteps().run(PlainContext()).check()
