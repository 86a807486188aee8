"""``tune.property``: any number of any stage is met, or what is nearest is said."""

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.errors import ConfigError, ConfigErrors, DesignError
from sppm_pipeline.method.families.tuner import options_at, varied_option
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.stages.tune_property import TuneProperty
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import Context, Rejected, Stage, option
from sppm_pipeline.testing.plain_context import PlainContext, recipe_of


@dataclass(frozen=True, eq=False)
class Plate(ScalarField):
    """A plate of solid."""

    height: float
    luck: float

    @property
    def cells(self):
        return (1, 1, 1)

    @property
    def periodic(self):
        return True

    def sample_layers(self, grid, start, stop, threads=1):
        return np.zeros((*grid.shape[:2], stop - start), np.float32)


@dataclass(frozen=True, kw_only=True)
class Make(Stage):
    """Make a plate."""

    name: ClassVar[str] = "field.plate"
    reported: ClassVar[tuple[str, ...]] = ("luck",)
    height: float = option(0.5, help="height")
    count: int = option(7, help="count", minimum=1)
    gap: Length | None = option(None, help="gap")

    def run(self, context: Context) -> Plate:
        luck = float(context.rng().normal())
        context.report(luck=luck)
        if self.height > 1.9:
            raise Rejected("too high")
        return Plate(self.height + self.count, luck)


@dataclass(frozen=True, kw_only=True)
class Measure(Stage):
    """Report numbers of a plate, and make nothing."""

    name: ClassVar[str] = "check.plate"
    reported: ClassVar[tuple[str, ...]] = (
        "rising", "peak", "step", "noisy", "absent", "negative", "list.#2", "shared", "both.one",
    )  # fmt: skip
    count: int = option(7, help="count", minimum=1)

    def run(self, context: Context, plate: Plate) -> None:
        h = plate.height - 7
        context.report(
            rising=math.exp(3 * h), peak=1 - (h - 0.4) ** 2, step=1.0 if h < 0.3 else 2.0, negative=-h,
            noisy=math.exp(h) * (1 + 0.2 * plate.luck), list=[h, plate.height * self.count], both={"one": h},
        )  # fmt: skip


def tuned(seed=0, **options):
    """The field, what was reported and the context, of a recipe of a synthetic structure."""
    context = PlainContext(seed)
    given = {"vary": "field.plate.height", "low": 0.0, "high": 1.0} | options
    made = TuneProperty(**given).run(context, recipe_of(Make(), Measure()))
    return made, context.reported, context


def test_a_number_is_met_and_what_is_made_has_it():
    made, said, _ = tuned(of="check.plate.rising", target=5.0, accuracy=1e-6)
    assert isinstance(made, Plate)
    assert said["reached"] == pytest.approx(5, rel=1e-6)
    assert said["value"] == pytest.approx(math.log(5) / 3, rel=1e-6)
    assert math.exp(3 * (made.height - 7)) == said["reached"] == said["chosen"]
    assert said["evaluations"] == len(said["curve"]) == 4
    assert (said["deviation"], said["draw"], said["failed"]) == (None, 0, 0)


def test_numbers_may_be_named_alone_in_lists_and_maps_and_be_negative():
    assert tuned(of="peak", target=0.9, low=0.4)[1]["value"] == pytest.approx(0.4 + 0.1**0.5, rel=0.1)
    assert tuned(of="check.plate.list.1", target=0.3)[1]["reached"] == pytest.approx(0.3, rel=0.02)
    assert tuned(of="both.one", target=0.3)[1]["reached"] == pytest.approx(0.3, rel=0.02)
    assert tuned(of="negative", target=-0.3)[1]["value"] == pytest.approx(0.3, rel=0.02)


def test_draws_have_a_mean_and_a_spread_and_the_nearest_comes_out():
    made, said, context = tuned(of="noisy", target=2.0, draws=5, accuracy=0.01)
    at = said["value"]
    luck = np.array([recipe_of(Make(height=at)).run(PlainContext(0), attempt=k).luck for k in range(5)])
    numbers = math.exp(at) * (1 + 0.2 * luck)
    assert said["reached"] == pytest.approx(numbers.mean())
    assert said["reached"] == pytest.approx(2, rel=0.01)
    assert said["deviation"] == pytest.approx(numbers.std(ddof=1))
    assert said["draw"] == np.abs(numbers - 2).argmin()
    assert said["chosen"] == pytest.approx(numbers[said["draw"]])
    assert made.luck == luck[said["draw"]]
    assert ["draws would do" in warning for warning in context.warnings] == [True]
    assert tuned(of="noisy", target=2.0, draws=5, accuracy=0.01)[1] == said


def test_draws_that_are_rejected_are_left_out_with_a_warning():
    _, said, context = tuned(of="rising", target=20.0, high=2.0)
    assert said["failed"] == 1
    assert context.warnings == ["left out: too high, at field.plate.height = 2"]
    with pytest.raises(DesignError, match=r"no value of field.plate.height gives check.plate.rising: too high"):
        tuned(of="rising", target=20.0, low=1.95, high=2.0)
    with pytest.raises(DesignError, match=r"no run of the recipe reports check.plate.absent"):
        tuned(of="absent", target=1.0)


@pytest.mark.parametrize(
    ("options", "words", "hint"),
    [
        ({"of": "rising", "target": 30.0}, r"for field.plate.height from 0 to 1: there are 1 to 20.09; the nearest is "
         r"20.09 at field.plate.height = 1, the bound `high`", "`high` of field.plate.height"),
        ({"of": "rising", "target": 0.5}, "the bound `low`", "`low` of field.plate.height"),
        ({"of": "peak", "target": 1.5}, r"the nearest is (1|0\.99\d*) at field.plate.height = 0\.3\d+", "no bound"),
        ({"of": "step", "target": 1.5}, r"field.plate.height = 0.2999\d* to 0.3000\d* it jumps from 1 to 2", "smooth"),
        ({"of": "noisy", "target": 9.0, "draws": 3}, r"the nearest is \S+ \+- \S+ at", "`high`"),
        ({"of": "rising", "target": 5.0, "accuracy": 1e-15, "evaluations": 5}, "not met after 5 evaluations", "raise"),
        ({"of": ("rising", "negative"), "target": (5.0, -0.1), "vary": ("field.plate.height", "field.plate.count"),
          "low": (0.0, 6.0), "high": (0.6, 8.0), "evaluations": 60}, "are not reachable together", "number of pores"),
    ],
)  # fmt: skip
def test_what_is_out_of_reach_is_said(options, words, hint):
    with pytest.raises(DesignError, match=words) as raised:
        tuned(**options)
    assert hint in raised.value.hint


def test_runs_are_remembered_for_other_targets_and_more_draws(tmp_path):
    def reach(**options):
        context = PlainContext(0)
        context._store = Store(tmp_path)
        TuneProperty(vary="field.plate.height", low=0.0, high=1.0, **options).run(context, recipe_of(Make(), Measure()))
        ran = context.log.inner["recipe.check.plate"]["runs"] if "recipe.check.plate" in context.log.inner else 0
        return ran, dict(context.reported)

    first, said = reach(of="rising", target=5.0)
    assert first == said["evaluations"] == 4
    again, same = reach(of="rising", target=5.0)
    assert (again, same) == (1, said)  # the structure itself is made
    # the three values that are tried first are known; one run is that of what comes out, unless it was the last
    other, said = reach(of="list.1", target=0.3)
    assert other == said["evaluations"] - 3
    more, said = reach(of="rising", target=5.0, draws=2)
    assert more <= said["evaluations"] + 1
    assert tuned(of="rising", target=5.0, draws=2)[1] == said


def test_draws_that_failed_are_remembered_too(tmp_path):
    def reach(**options):
        context = PlainContext(0)
        context._store = Store(tmp_path)
        given = {"of": "rising", "target": 20.0, "low": 0.0, "high": 2.0} | options
        try:
            TuneProperty(vary="field.plate.height", **given).run(context, recipe_of(Make(), Measure()))
        except DesignError as error:
            context.warnings.append(error.message)
        inner = context.log.inner.get("recipe.field.plate", {"runs": 0})
        return inner["runs"], context.warnings, dict(context.reported)

    first = reach()
    assert first[1] == ["left out: too high, at field.plate.height = 2"]
    assert (first[0], first[2]["failed"]) == (first[2]["evaluations"] - 1, 1)
    again = reach()
    assert again[0] == 1  # the structure that comes out is made
    assert again[1:] == first[1:]
    hopeless = {"low": 1.95, "high": 2.0}
    assert reach(**hopeless)[1:] == reach(**hopeless)[1:]
    assert reach(**hopeless)[0] == 0


def test_integers_lengths_and_options_of_all_stages():
    _, said, _ = tuned(of="list.2", target=150.0, vary="count", low=3, high=30)
    assert said["value"] == 12  # 0.5 + 12 of one stage, times 12 of the other
    assert all(float(value).is_integer() for value, _ in said["curve"])


def test_integers_are_not_tried_beyond_the_bounds():
    _, said, _ = tuned(of="list.2", target=150.0, vary="count", low=3.4, high=30.6)
    assert [said["curve"][0][0], said["curve"][-1][0]] == [4, 30]
    with pytest.raises(DesignError, match="the bound `low`"):
        tuned(of="list.2", target=1.0, vary="count", low=3.4, high=30)
    with pytest.raises(ConfigError, match=r"takes integers, and there are not two of them from 3\.4 to 4\.6"):
        tuned(of="list.2", target=150.0, vary="count", low=3.4, high=4.6)


def test_two_numbers_are_met_by_two_options():
    _, said, _ = tuned(
        of=("list.1", "list.2"), target=(0.9, 86.9), vary=("field.plate.height", "check.plate.count"),
        low=(0.0, 2.0), high=(1.5, 30.0), accuracy=0.01,
    )  # fmt: skip
    assert said["reached"] == pytest.approx([0.9, 86.9], rel=0.01)
    assert said["value"] == pytest.approx([0.9, 11], rel=0.01)
    assert said["deviation"] == [None, None]


def test_what_is_not_there_is_refused_before_any_run():
    for options, words, hint in (
        ({"of": "check.plate.risng"}, "no number|reports a number 'check.plate.risng'", "'check.plate.rising'"),
        ({"of": "list"}, "'list'", "'check.plate.list.1'"),
        ({"of": "check.plate.xyzzy"}, "xyzzy", "numbers of check.plate: absent, both.one"),
        ({"of": "rising", "vary": "field.plate.hight"}, "no option 'field.plate.hight'", "field.plate.height"),
    ):
        with pytest.raises(ConfigError, match=words) as raised:
            tuned(**{"target": 1.0, **options})
        assert hint in raised.value.hint
    for options, words in (
        ({"target": (1.0, 2.0)}, "`of` holds 1 and `target` 2"),
        ({"low": 1.0}, "should rise"),
        ({"first": 9, "evaluations": 8}, "takes 9 evaluations"),
        ({"of": ("a", "a"), "target": (1.0, 1.0), "vary": ("a", "b"), "low": (0.0, 0.0), "high": (1.0, 1.0)}, "twice"),
    ):
        with pytest.raises(ConfigError, match=words):
            TuneProperty(**{"of": "a", "target": 1.0, "vary": "b", "low": 0.0, "high": 1.0, **options}).check_options()


REAL = """
recipes:
  pores:
    - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
    - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.06}
  cell:
    - {stage: tune.porosity, id: porous, recipe: pores, target: 0.6, resolution: 12, tolerance: 0.02}
    - {stage: homogenize.conductivity, id: pores, of: void, resolution: 10}
    - {stage: check.sizes, id: sizes, resolution: 12}
pipeline:
  - {stage: tune.property, id: tuned, recipe: cell, OPTIONS}
  - {stage: check.porosity, resolution: 24}
"""


def test_a_real_cell_has_a_conductivity_and_a_surface(run_yaml, summary):
    record, _ = run_yaml(REAL.replace("OPTIONS", (
        "of: [pores.k.1.1, specific_surface], target: [0.4, 4.9], accuracy: 0.03, first: 2, "
        "vary: [porous.target, pores.field.gaussian.tunnel_radius], low: [0.4, 0.03], high: [0.8, 0.09]"
    )))  # fmt: skip
    said = summary(record, "tuned")
    assert said["reached"] == pytest.approx([0.4, 4.9], rel=0.03)
    assert summary(record, "check.porosity")["porosity"] == pytest.approx(said["value"][0], abs=0.03)
    # the last run of the recipe is that of the cell that comes out
    inner = {entry["id"]: entry["summary"] for entry in record["stages"][0]["inner"]}
    assert inner["cell.pores"]["k"][0][0] == said["reached"][0]


def test_two_sizes_are_met_by_the_porosity_and_a_common_factor_of_all_lengths(run_yaml, summary):
    """Sizes in mm follow the factor, and their ratio the porosity; shapes stay, so that radii over the cell do."""
    text = REAL.replace("OPTIONS", (
        "of: [sizes.strut.mean, sizes.pore.mean], target: [0.5, 1.5], accuracy: 0.02, first: 2, "
        "vary: [porous.target, lengths], low: [0.5, 0.5], high: [0.8, 1.5]"
    ))  # fmt: skip
    text = text.replace("resolution: 12", "resolution: 24").replace("count: 9", "edge: 4 mm, count: 9")
    record, _ = run_yaml(text)
    said = summary(record, "tuned")
    assert said["reached"] == pytest.approx([0.5, 1.5], rel=0.02)
    assert 0.5 < said["value"][1] < 1.5


def test_a_common_factor_scales_each_length_in_its_unit():
    made = recipe_of(Make(gap=Length(3, "mm")), Make(gap=Length(40, "um")), Make(gap=Length(0.1)))
    varied = varied_option(made, "lengths")
    assert options_at([varied], [1.5]) == {
        "field.plate": {"gap": Length(4.5, "mm")}, "field.plate#2": {"gap": Length(60, "um")}
    }  # fmt: skip
    with pytest.raises(ConfigError, match="states no length with a unit"):
        varied_option(recipe_of(Make(gap=Length(0.1))), "lengths")


def test_a_recipe_without_a_field_is_refused(run_yaml):
    with pytest.raises((ConfigError, ConfigErrors), match="no stage of the recipe 'cell' makes a ScalarField"):
        run_yaml("""
recipes:
  cell:
    - {stage: sample.dart_throwing, count: 12}
pipeline:
  - {stage: tune.property, recipe: cell, of: pores, target: 3, vary: count, low: 1, high: 9}
""")
