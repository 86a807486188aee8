"""Former names of stages and options: old configurations run as they did, and say what the names are now."""

from __future__ import annotations

import pytest

from sppm_pipeline.engine.plan.describe import stage_list, stage_text
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.schema import configuration_schema
from sppm_pipeline.errors import PluginError

RENAMED = '''
from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.stage import Context, Stage, StageAlias, option
from tests.synthetic import Number


@dataclass(frozen=True, kw_only=True)
class Draw(Stage):
    """A random number, scaled."""

    name: ClassVar[str] = "sample.draw"
    scale: float = option(help="a factor", above=0, formerly="factor")
    shift: float = option(0.0, help="added at the end")

    def run(self, context: Context) -> Number:
        return Number(self.shift + self.scale * float(context.rng().random()))


def shifted(written):
    return {"shift": 10.0, "scale": 1.0 if "shift" in written else 2.0}


@hookimpl
def sppm_stages():
    return {"sample.draw": Draw}


@hookimpl
def sppm_stage_aliases():
    return {
        "sample.throw": "sample.draw",
        "sample.double": StageAlias("sample.draw", {"scale": 2.0}),
        "sample.shifted": StageAlias("sample.draw", shifted),
    }
'''


@pytest.fixture
def renamed(work):
    return work.write(RENAMED, "renamed.py")


def value(record):
    return record["stages"][0]["summary"]["value"]


def test_a_former_stage_name_draws_the_same_numbers_and_says_so_once(work, renamed):
    text = "pipeline: [{stage: sample.throw, scale: 1}, {stage: sample.throw, scale: 1}]"
    plan = work.plan(text, plugins=[renamed])
    assert [step.id for step in plan.steps] == ["sample.throw", "sample.throw#2"]
    assert [step.stage.name for step in plan.steps] == ["sample.draw"] * 2
    place = f"{work.folder / 'config.yaml'}:2:20"
    assert plan.warnings == (f"{place}: stage 'sample.throw' is now 'sample.draw'; the old name works in this version",)
    record = work.run(text, plugins=[renamed])
    old = work.run("pipeline: [{stage: sample.draw, scale: 1, id: sample.throw}]", plugins=[renamed], to="new")
    assert value(record) == value(old)
    assert record["warnings"] == [words.replace(f"{work.folder}/", "") for words in plan.warnings]


def test_the_record_of_a_run_names_the_stage_as_it_is_called_now(work, renamed):
    record = work.run("pipeline: [{stage: sample.throw, factor: 3}]", plugins=[renamed])
    assert record["config"]["pipeline"] == [{"stage": "sample.draw", "id": "sample.throw", "scale": 3.0, "shift": 0.0}]


def test_what_a_former_name_implied_holds_unless_it_is_written(work, renamed):
    steps = work.plan(
        "pipeline:\n- sample.double\n- {stage: sample.double, scale: 5}\n- sample.shifted\n"
        "- {stage: sample.shifted, shift: 1}",
        plugins=[renamed],
    ).steps
    assert [(step.stage.scale, step.stage.shift) for step in steps] == [(2, 0), (5, 0), (2, 10), (1, 1)]


def test_a_former_option_name_works_in_the_file_and_on_the_command_line(work, renamed):
    text = "pipeline: [{stage: sample.draw, factor: 3}]"
    plan = work.plan(text, plugins=[renamed])
    assert plan.steps[0].stage.scale == 3
    assert plan.warnings == (
        f"{work.folder / 'config.yaml'}:2:33: the option 'factor' of sample.draw is now 'scale'; the old name works in "
        "this version",
    )
    for written in ("factor", "scale"):
        for override in ("factor", "scale"):
            plan = work.plan(
                f"pipeline: [{{stage: sample.draw, {written}: 3}}]", plugins=[renamed], s=[f"sample.draw.{override}=7"]
            )
            assert plan.steps[0].stage.scale == 7


def test_an_option_under_both_names_is_refused(work, renamed):
    error = work.error("pipeline: [{stage: sample.draw, factor: 3, scale: 4}]", plugins=[renamed])
    assert "the option 'scale' is given twice, also by its former name" in error.message
    assert work.place(error) == (2, 44)


def test_a_stage_may_set_an_option_of_a_recipe_by_its_former_name(work, renamed):
    record = work.run(
        "recipes: {r: [{stage: sample.draw, scale: 3}]}\n"
        "pipeline: [{stage: tune.repeat, recipe: r, target: sample.draw, option_name: factor, value: 1.0e-9}]",
        plugins=[renamed],
    )
    assert record["stages"][0]["warnings"] == [
        "the option 'factor' of sample.draw is now 'scale'; the old name works in this version"
    ]
    assert value(record) < 1e-8


def test_lists_and_references_show_current_names_only(renamed):
    registry = Registry(load_plugins([], files=[renamed], distributions=False))
    assert list(registry) == ["sample.draw"]
    assert "sample.throw" not in stage_list(registry, list(registry))
    assert "factor:" not in stage_text(registry.get("sample.throw"), registry)
    assert "sample.throw" in registry


def test_the_schema_accepts_former_names_and_marks_them_as_deprecated(renamed):
    schema = configuration_schema(Registry(load_plugins([], files=[renamed], distributions=False)))
    assert {"enum": ["sample.double", "sample.shifted", "sample.throw"], "deprecated": True} in schema["$defs"][
        "stage"
    ]["anyOf"]
    assert schema["$defs"]["sample.throw"]["deprecated"] is True
    assert schema["$defs"]["sample.throw"]["properties"]["factor"]["deprecated"] is True
    assert "deprecated" not in schema["$defs"]["sample.draw"]["properties"]["scale"]


def test_a_former_name_must_not_hide_a_stage_or_another_former_name(work, renamed):
    second = work.write(
        "from sppm_pipeline.hookspecs import hookimpl\n\n@hookimpl\ndef sppm_stage_aliases():\n"
        "    return {'sample.throw': 'sample.draw'}\n",
        "second.py",
    )
    with pytest.raises(PluginError, match=r"'sample.throw' comes from the plugin .*renamed.py and from the plugin"):
        load_plugins([], files=[renamed, second], distributions=False).raise_broken()


def test_an_option_cannot_take_over_a_name_that_is_in_use(work):
    bad = work.write(
        RENAMED.replace('option(0.0, help="added at the end")', 'option(0.0, help="added", formerly="scale")'), "bad.py"
    )
    with pytest.raises(PluginError, match="declares 'scale' both as an option and as a former name"):
        Registry(load_plugins([], files=[bad], distributions=False)).get("sample.draw")


def test_built_in_former_names_lead_to_stages_there_are():
    from tests.built_in import STAGE_ALIASES, STAGES

    targets = [alias if isinstance(alias, str) else alias.name for alias in STAGE_ALIASES.values()]
    assert set(targets) <= set(STAGES)
    assert not set(STAGE_ALIASES) & set(STAGES)
