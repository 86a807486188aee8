"""The top level of a file, ids, parameters and overrides."""

from __future__ import annotations

import pytest

ONE = "pipeline:\n  - {stage: read.number, value: 1}\n"


@pytest.mark.parametrize(
    ("text", "words", "place"),
    [
        ("sppm: 2\n" + ONE, "format version 2 is unknown", (1, 7)),
        ("sppm: true\n" + ONE, "format version true", (1, 7)),
        ("sppm: 1\nnaem: x\n" + ONE, "did you mean 'name'", (2, 1)),
        ("sppm: 1\nname: a/b\n" + ONE, "`name` must be a string", (2, 7)),
        ("sppm: 1\nname: ..\n" + ONE, "`name` must be a string", (2, 7)),
        ("sppm: 1\nseed: -1\n" + ONE, "at least 0", (2, 7)),
        ("sppm: 1\nseed: 1.5\n" + ONE, "an integer", (2, 7)),
        ("sppm: 1\nparams: [1]\n" + ONE, "`params` must be a map", (2, 9)),
        ("sppm: 1\nparams: {a-b: 1}\n" + ONE, "parameter name", (2, 10)),
        ("sppm: 1\nrecipes: {a.b: [{stage: read.number, value: 1}]}\n" + ONE, "recipe name", (2, 11)),
        ("sppm: 1\nname: x\n", "`pipeline` is missing", (1, 1)),
        ("sppm: 1\nafter: []\n" + ONE, "there is no `sweep`", (2, 1)),
        ("sppm: 1\nsweep: 3\n" + ONE, "`sweep` must be", (2, 8)),
        ("sppm: 1\nnotes: [1]\n" + ONE, "`notes` must be a map", (2, 8)),
        ("sppm: 1\nplugins: [3]\n" + ONE, "path of a Python file", (2, 11)),
        ("sppm: 1\npipeline: []\n", "at least one stage", (2, 11)),
        ("sppm: 1\npipeline:\n  - {id: x}\n", "key `stage`", (3, 5)),
        ("sppm: 1\npipeline:\n  - {stage: 3}\n", "name of a stage, got 3", (3, 13)),
        ("sppm: 1\npipeline:\n  - {stage: read.number, value: 1, id: a/b}\n", "an id consists", (3, 40)),
    ],
)
def test_errors_of_the_layout(work, text, words, place):
    error = work.error(text)
    assert words in str(error)
    assert work.place(error) == place


def test_the_version_must_be_there(work):
    work.write(ONE, "bare.yaml")
    from sppm_pipeline.engine.plan.session import RunRequest
    from sppm_pipeline.errors import ConfigError

    with pytest.raises(ConfigError, match="`sppm` is missing"):
        RunRequest(str(work.folder / "bare.yaml")).read()


def test_name_and_seed_have_defaults(work):
    plan = work.plan(ONE)
    assert plan.name == "config"
    assert plan.seed == 0
    assert work.plan(ONE, seed=9).seed == 9


def test_notes_enter_no_run(work):
    plain, noted = (work.plan(ONE + notes) for notes in ("", "notes: {paper: [0.2, 0.5], text: '${none}'}\n"))
    assert noted.document == plain.document


def test_ids_default_to_names_and_are_numbered(work):
    plan = work.plan("pipeline: [read.varied, {stage: read.varied}, {stage: read.varied, id: 'read.varied#2'}]\n")
    assert [step.id for step in plan.steps] == ["read.varied", "read.varied#3", "read.varied#2"]


def test_an_id_used_twice_is_refused(work):
    error = work.error(
        "pipeline:\n  - {stage: read.number, value: 1, id: a}\n  - {stage: read.number, value: 1, id: a}\n"
    )
    assert "'a' is used twice; first at" in error.message
    assert work.place(error)[0] == 4


PARAMS = """params: {v: 4, word: two, stage: read.number}
pipeline:
  - {stage: "${stage}", value: "${v}"}
  - {stage: read.varied, word: "${word}", pair: [1, "${v}"]}
"""


def test_parameters_stand_for_whole_values(work):
    number, varied = work.plan(PARAMS).steps
    assert number.stage.value == 4
    assert varied.stage.word == "two"
    assert varied.stage.pair == (1, 4)


def test_parameters_can_be_set_from_the_command_line(work):
    number, varied = work.plan(PARAMS, p=["v=7", "word=one"]).steps
    assert number.stage.value == 7
    assert varied.stage.word == "one"


@pytest.mark.parametrize(
    ("text", "words", "place"),
    [
        ("params: {v: 4}\npipeline:\n  - {stage: read.number, value: '${w}'}\n", "no parameter 'w'", (4, 33)),
        ("pipeline:\n  - {stage: read.number, value: '${w}'}\n", "has no `params`", (3, 33)),
        ("params: {v: 4}\npipeline:\n  - {stage: read.number, value: '1${v}'}\n", "whole value", (4, 33)),
        ("params: {v: x}\npipeline:\n  - {stage: read.number, value: '${v}'}\n", "expected a number", (2, 13)),
        ("params: {v: 4, w: '${v}'}\npipeline:\n  - {stage: read.number, value: '${v}'}\n", "can't refer", (2, 19)),
    ],
)
def test_errors_of_parameters(work, text, words, place):
    error = work.error(text)
    assert words in str(error)
    assert work.place(error) == place


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("v", "expected name=value"),
        ("vv=3", "did you mean 'v'"),
        ("v=x", "expected a number"),
        ("v=[", "not valid YAML"),
    ],
)
def test_errors_of_parameters_on_the_command_line(work, argument, words):
    error = work.error("params: {v: 4}\npipeline:\n  - {stage: read.number, value: '${v}'}\n", p=[argument])
    assert words in str(error)
    assert str(error).startswith(f"-p {argument}: ")


def test_unused_parameters_and_recipes_are_warned_of(work):
    text = "params: {v: 4}\nrecipes:\n  r: [{stage: read.number, value: 1}]\n" + ONE
    assert work.plan(text).warnings == (
        f"{work.folder / 'config.yaml'}:2:10: the parameter 'v' is not used",
        f"{work.folder / 'config.yaml'}:4:3: the recipe 'r' is not used",
    )


TWO_RECIPES = """recipes:
  a: [{stage: sample.random, count: 1}, {stage: field.scale}]
  b: [{stage: sample.random, count: 2}]
pipeline:
  - {stage: tune.repeat, id: first, recipe: a}
  - {stage: tune.repeat, id: second, recipe: b}
  - {stage: read.varied}
"""


@pytest.mark.parametrize(
    ("argument", "get", "value"),
    [
        ("read.varied.whole=7", lambda plan: plan.steps[2].stage.whole, 7),
        ("varied.whole=7", lambda plan: plan.steps[2].stage.whole, 7),
        ("varied.pair=[2, 3]", lambda plan: plan.steps[2].stage.pair, (2, 3)),
        ("varied.length=5 mm", lambda plan: str(plan.steps[2].stage.length), "5 mm"),
        ("first.attempts=7", lambda plan: plan.steps[0].stage.attempts, 7),
        ("a.sample.random.count=7", lambda plan: plan.recipes["a"][0].stage.count, 7),
        ("b.sample.count=7", lambda plan: plan.recipes["b"][0].stage.count, 7),
        ("field.scale.factor=7", lambda plan: plan.recipes["a"][1].stage.factor, 7),
        ("scale.factor=1e-3", lambda plan: plan.recipes["a"][1].stage.factor, 0.001),
        ("field.factor=7", lambda plan: plan.recipes["a"][1].stage.factor, 7),
    ],
)
def test_overrides_reach_any_stage(work, argument, get, value):
    assert get(work.plan(TWO_RECIPES, s=[argument])) == value


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("sample.random.count=7", "'a.sample.random' or 'b.sample.random'"),
        ("tune.repeat.attempts=7", "'first' or 'second'"),
        ("sample.rnadom.count=7", "did you mean 'b.sample.random' or 'a.sample.random'"),
        ("second.attempst=7", "did you mean 'attempts'"),
        ("first.recipe=b", "`recipe` can't be set"),
        ("count=7", "expected stage.option=value"),
        ("first.attempts", "expected stage.option=value"),
        ("first.attempts=0", "at least 1"),
    ],
)
def test_errors_of_overrides(work, argument, words):
    error = work.error(TWO_RECIPES, s=[argument])
    assert words in str(error)
    assert str(error).startswith(f"-s {argument}: ")
