"""Which stage each port takes its artifact from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import pytest

from sppm_pipeline.engine.plan.describe import dot_graph, mermaid_graph, wiring_text
from sppm_pipeline.engine.plan.ports import artifact_words, fits, signature_of
from sppm_pipeline.errors import ConfigErrors, PluginError, WiringError
from sppm_pipeline.stage import Context, Recipe, Stage
from tests.synthetic import Number, Text, Whole

A = "  - {stage: read.number, value: 1, id: a}\n"
B = "  - {stage: read.number, value: 2, id: b}\n"


def inputs(plan, id_):
    return next(dict(step.inputs) for step in plan.steps if step.id == id_)


def test_the_nearest_earlier_stage_is_taken(work):
    plan = work.plan(f"pipeline:\n{A}{B}  - field.scale\n")
    assert inputs(plan, "field.scale") == {"number": "b"}


def test_from_overrides(work):
    plan = work.plan(f"pipeline:\n{A}{B}  - {{stage: field.scale, from: a}}\n")
    assert inputs(plan, "field.scale") == {"number": "a"}


def test_from_can_name_ports(work):
    plan = work.plan(f"pipeline:\n{A}{B}  - {{stage: fill.sum, from: {{left: b, right: a}}}}\n")
    assert inputs(plan, "fill.sum") == {"left": "b", "right": "a"}


def test_a_port_that_takes_many_takes_all_there_are_or_those_of_from(work):
    written = [("", ["a", "b"]), (", from: b", ["b"]), (", from: [b, a]", ["b", "a"])]
    for asked, order in [*written, (", from: {numbers: [b, a, b]}", ["b", "a", "b"])]:
        plan = work.plan(f"pipeline:\n{A}  - read.varied\n{B}  - {{stage: fill.total{asked}}}\n")
        (port,) = plan.steps[-1].signature.ports
        assert plan.steps[-1].sources(port) == order
        assert f"numbers: from {', '.join(order)}\n" in wiring_text(plan)
        assert all(f'"{id_}" -> "fill.total"' in dot_graph(plan) for id_ in order)
    assert work.run(f"pipeline:\n{A}{B}  - {{stage: fill.total, from: [b, a, b]}}\n")["stages"][-1]["summary"] == {
        "value": 5
    }


def test_a_noun_of_a_narrower_kind_fits(work):
    plan = work.plan("pipeline: [read.whole, field.scale]\n")
    assert inputs(plan, "field.scale") == {"number": "read.whole"}


def test_an_optional_port_stays_open_without_a_noun(work):
    plan = work.plan(f"pipeline:\n  - sample.random\n{A}  - {{stage: sample.random, id: c}}\n")
    assert inputs(plan, "sample.random") == {"base": None}
    assert inputs(plan, "c") == {"base": "a"}


def test_a_union_takes_the_nearest_of_its_kinds(work):
    plan = work.plan(f"pipeline:\n{A}  - extract.text\n  - write.number\n")
    assert inputs(plan, "write.number") == {"source": "extract.text"}
    plan = work.plan(f"pipeline:\n{A}  - extract.text\n{B}  - write.number\n")
    assert inputs(plan, "write.number") == {"source": "b"}


def test_a_stage_can_pass_on_what_it_was_given(work):
    plan = work.plan("pipeline: [read.whole, check.limit, field.scale]\n")
    assert plan.steps[1].makes == (Whole,)


def test_a_stage_with_a_recipe_can_make_what_the_recipe_makes(work):
    plan = work.plan("recipes:\n  r: [read.whole]\npipeline:\n  - {stage: tune.repeat, recipe: r}\n  - field.scale\n")
    assert plan.steps[0].makes == (Whole,)
    assert inputs(plan, "field.scale") == {"number": "tune.repeat"}


def test_recipes_can_use_recipes_in_any_order(work):
    plan = work.plan(
        "recipes:\n  outer: [{stage: tune.repeat, recipe: inner}]\n  inner: [read.whole]\n"
        "pipeline:\n  - {stage: tune.repeat, recipe: outer}\n"
    )
    assert plan.steps[0].makes == (Whole,)
    assert list(plan.recipes) == ["outer", "inner"]


@pytest.mark.parametrize(
    ("pipeline", "words", "place"),
    [
        ("  - field.scale\n", "needs Number, which no earlier stage makes\n  hint: nothing is made before", (3, 5)),
        ("  - read.varied\n  - field.scale\n", "made before: Text by read.varied", (4, 5)),
        (f"{A}  - {{stage: fill.sum}}\n", "'left' and 'right' would both take the result of 'a'", (4, 13)),
        (f"{A}  - {{stage: fill.sum, from: a}}\n", "fits the ports 'left' and 'right'", (4, 29)),
        (f"{A}  - {{stage: field.scale, from: c}}\n", "no earlier stage 'c'", (4, 32)),
        (f"{A}  - {{stage: field.scale, from: 3}}\n", "takes the id of a stage", (4, 32)),
        (f"{A}{B}  - {{stage: field.scale, from: [a, b]}}\n", "takes one artifact, and two are given", (5, 36)),
        (f"{A}  - {{stage: fill.total, from: [a, c]}}\n", "no earlier stage 'c'", (4, 35)),
        (f"{A}  - {{stage: fill.total, from: []}}\n", "takes the id of a stage, a list of ids", (4, 31)),
        ("  - read.varied\n  - fill.total\n", "needs one or more of Number, which no earlier stage makes", (4, 5)),
        (f"  - {{stage: field.scale, from: a}}\n{A}", "'a' does not come before this stage", (3, 32)),
        (f"{A}  - {{stage: field.scale, id: x, from: x}}\n", "does not come before", (4, 39)),
        (f"{A}  - {{stage: field.scale, from: {{nmuber: a}}}}\n", "did you mean 'number'", (4, 33)),
        ("  - read.varied\n  - {stage: field.scale, from: read.varied}\n", "makes Text, but number takes", (4, 32)),
        (f"{A}  - write.number\n  - {{stage: extract.text, from: write.number}}\n", "makes nothing", (5, 33)),
        ("  - {stage: read.nubmer, value: 1}\n", "did you mean 'read.number'", (3, 13)),
        ("  - {stage: number, value: 1}\n", "'read.number'", (3, 13)),
        ("  - {stage: write.hologram}\n", "stages of this family: write.column, write.number", (3, 13)),
        ("  - {stage: zzz.qqq}\n", "`sppm stages` lists all stages", (3, 13)),
        ("  - {stage: tune.repeat}\n", "repeats a recipe, but none is given for 'recipe'", (3, 13)),
        ("  - {stage: tune.repeat, recipe: r}\n", "the file has no `recipes`", (3, 34)),
        ("  - {stage: read.number, value: 1, recipe: r}\n", "takes no recipe", (3, 44)),
    ],
)
def test_errors_of_wiring(work, pipeline, words, place):
    error = work.error(f"pipeline:\n{pipeline}")
    assert words in str(error)
    assert work.place(error) == place


@pytest.mark.parametrize(
    ("recipes", "words"),
    [
        ("cell: [read.whole]", "did you mean 'cell'"),
        ("cel: [field.scale]", "needs Number, which no earlier stage makes"),
        ("cel: [read.whole, write.number]", "ends in a stage that makes nothing"),
        ("cel: []", "at least one stage"),
        ("cel: [{stage: tune.repeat, recipe: cel}]", "in a circle: cel -> cel"),
        (
            "{cel: [{stage: tune.repeat, recipe: b}], b: [{stage: tune.repeat, recipe: cel}]}",
            "in a circle: cel -> b -> cel",
        ),
    ],
)
def test_errors_of_recipes(work, recipes, words):
    recipes = recipes if recipes.startswith("{") else f"{{{recipes}}}"
    error = work.error(f"recipes: {recipes}\npipeline:\n  - {{stage: tune.repeat, recipe: cel}}\n")
    assert words in str(error)


def test_all_errors_at_once_in_the_order_of_the_file(work):
    errors = work.errors(
        "recipes:\n  r: [field.scale]\npipeline:\n  - extract.text\n  - {stage: tune.repeat, recipe: s}\n"
        "  - {stage: read.number, value: x}\n"
    )
    assert [work.place(error)[0] for error in errors] == [3, 5, 6, 7]
    with pytest.raises(ConfigErrors):
        work.plan("pipeline: [extract.text, {stage: read.number, value: x}]\n")


def test_an_unknown_stage_does_not_make_its_followers_wrong(work):
    error = work.error("pipeline:\n  - read.nubmer\n  - field.scale\n  - extract.text\n")
    assert "read.nubmer" in error.message


def test_wiring_errors_have_a_kind_of_their_own(work):
    assert isinstance(work.error("pipeline: [field.scale]\n"), WiringError)


FULL = """recipes:
  r: [sample.random, field.scale]
pipeline:
  - {stage: tune.repeat, id: best, recipe: r}
  - sample.random
  - {stage: write.number, from: best}
"""


def test_the_wiring_as_text_says_where_each_port_comes_from(work):
    lines = [" ".join(line.split()) for line in wiring_text(work.plan(FULL)).splitlines()]
    assert lines == [
        "recipe r",
        "1 sample.random -> Number",
        "base: (open)",
        "2 field.scale -> Number",
        "number: from sample.random",
        "pipeline config",
        "1 best (tune.repeat) -> Number",
        "recipe: repeats the recipe r",
        "2 sample.random -> Number",
        "base: from best",
        "3 write.number -> nothing",
        "source: from best",
    ]


def test_the_wiring_as_graphs(work):
    plan = work.plan(FULL)
    dot = dot_graph(plan)
    assert '"r/sample.random" -> "r/field.scale" [label="number: Number"];' in dot
    assert '"r/field.scale" -> "best" [label="recipe", style=dashed];' in dot
    assert dot.count("{") == dot.count("}")
    mermaid = mermaid_graph(plan)
    assert mermaid.startswith("flowchart LR\n")
    assert mermaid.count("subgraph") == mermaid.count("  end") == 2
    assert mermaid.count("-->") == 3
    assert mermaid.count("-.->") == 1


def stage_with(run: Any) -> type[Stage]:
    @dataclass(frozen=True, kw_only=True)
    class Made(Stage):
        """A stage."""

        name: ClassVar[str] = "check.made"

    Made.run = run
    return Made


def no_context(self, number: Number) -> Number: ...
def no_annotation(self, context: Context, number) -> Number: ...
def no_result(self, context: Context): ...
def many(self, context: Context, *numbers: Number) -> Number: ...
def anything(self, context: Context) -> Any: ...
def pairs(self, context: Context) -> tuple[Number, Text]: ...
def maybe_many(self, context: Context, numbers: tuple[Number | None, ...]) -> Number: ...
def mixed(self, context: Context, recipe: Recipe | Number) -> Number: ...
def unresolved(self, context: Context, number: NotThere) -> Number: ...  # noqa: F821


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (no_context, "first parameter"),
        (no_annotation, "has no annotation"),
        (no_result, "does not say what it makes"),
        (many, "each port needs a name"),
        (anything, "makes Any"),
        (pairs, "must be annotated with artifacts"),
        (maybe_many, "none is None"),
        (mixed, "either a recipe or artifacts"),
        (unresolved, "can't be resolved"),
    ],
)
def test_signatures_that_break_the_contract(run, words):
    with pytest.raises(PluginError, match=words):
        signature_of(stage_with(run))


def anything_goes(self, context: Context, thing: Any, *, more: Text | None = None) -> Number | None: ...


def test_signatures():
    signature = signature_of(stage_with(anything_goes))
    thing, more = signature.ports
    assert thing.types == (object,)
    assert fits((Whole,), thing)
    assert not fits((), thing)
    assert more.optional
    assert fits((Text,), more)
    assert not fits((Text, Number), more)
    assert fits((Text, type(None)), more)
    assert artifact_words(signature.makes) == "Number or nothing"
