"""Running plans: results, errors and who is at fault, records, repetition."""

from __future__ import annotations

import json
import weakref

import numpy as np
import pytest

from sppm_pipeline.engine.files import digest_of, files_in
from sppm_pipeline.engine.plan.planning import make_plan
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.steps import last_uses
from sppm_pipeline.engine.run.verification import verify_run
from sppm_pipeline.engine.strict_json import json_text, jsonable
from sppm_pipeline.errors import ConfigError, DesignError, InputError, PluginError, ResourceError, SppmError
from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.stage import Rejected
from tests import synthetic

CHAIN = """name: chain
seed: 3
pipeline:
  - {stage: sample.random, count: 4}
  - {stage: field.scale, factor: 3}
  - {stage: check.limit, maximum: 1, soft: true}
  - {stage: write.number, path: sub/result.txt}
"""


def stage(record, id_):
    return next(entry for entry in record["stages"] if entry["id"] == id_)


def test_a_run_and_its_record(work):
    record = work.run(CHAIN)
    assert json.loads((work.folder / "out" / "run.json").read_text()) == record
    assert record["status"] == "done"
    assert record["name"] == "chain"
    assert record["seed"] == 3
    assert record["error"] is None
    assert [entry["id"] for entry in record["stages"]] == [
        "sample.random",
        "field.scale",
        "check.limit",
        "write.number",
    ]
    random, scale, limit, write = record["stages"]
    assert random["made"] == "Number"
    assert random["seconds"] >= 0
    assert random["summary"]["count"] == 4
    assert random["options"] == {"count": 4}
    assert random["inputs"] == {"base": None}
    assert scale["summary"]["value"] == random["summary"]["value"] * 3
    assert scale["inputs"] == {"number": "sample.random"}
    assert limit["warnings"] == ["larger than 1"]
    assert write["made"] is None
    assert write["summary"] == {}
    (output,) = write["outputs"]
    assert output["path"] == "sub/result.txt"
    assert output["sha256"] == digest_of(work.folder / "out" / "sub" / "result.txt")
    assert {"sppm_pipeline", "python", "numpy"} <= set(record["versions"])
    assert record["peak_memory_mb"] > 1
    assert sorted(p.name for p in (work.folder / "out").iterdir()) == ["SHA256SUMS", "run.json", "sub"]


def test_the_same_again_gives_the_same(work):
    work.run(CHAIN, to="a")
    work.run(CHAIN, to="b", threads=4)
    assert digest_of(work.folder / "a" / "sub") == digest_of(work.folder / "b" / "sub")
    work.run(CHAIN, to="c", seed=4)
    assert digest_of(work.folder / "a" / "sub") != digest_of(work.folder / "c" / "sub")


def test_a_run_directory_can_be_used_again(work):
    work.run(CHAIN)
    work.run(CHAIN, s=["write.path=other.txt"])
    assert sorted(p.name for p in (work.folder / "out").iterdir()) == ["SHA256SUMS", "other.txt", "run.json"]


FULL = """name: full
seed: 3
params: {limit: 0.4, file: in.txt, pair: [2, 3]}
recipes:
  r:
    - {stage: sample.random}
    - {stage: check.limit, maximum: "${limit}"}
pipeline:
  - {stage: tune.repeat, id: best, recipe: r}
  - {stage: read.varied, file: "${file}", pair: "${pair}", length: 50 um, numbers: [0.1, 1e-3]}
  - {stage: write.number, from: best}
  - {stage: write.number, path: text.txt, from: read.varied}
"""


def test_a_record_repeats_its_run_from_anywhere(work, monkeypatch):
    first = work.run(FULL, to="a")
    (work.folder / "other").mkdir()
    (work.folder / "a" / "run.json").rename(work.folder / "other" / "run.json")
    monkeypatch.chdir(work.folder / "other")
    (work.folder / "config.yaml").unlink()

    def again(to, **overrides):
        from sppm_pipeline.engine.config.parameters import Overrides

        request = RunRequest("run.json", ("tests.synthetic",), (), False, Overrides(**overrides))
        return run_plan(open_session(request).plan(), work.folder / to, threads=1)

    second = again("b")
    for name in ("number.txt", "text.txt"):
        assert (work.folder / "a" / name).read_bytes() == (work.folder / "b" / name).read_bytes()
    assert second["config"] == first["config"]
    assert first["config"]["folder"] == ".."  # from the record; a record and what it reads move together
    third = again("c", params=("limit=0.2",))
    assert stage(third, "best")["summary"]["value"] <= 0.2


def test_the_record_holds_every_option_and_keeps_parameters(work):
    config = work.run(FULL)["config"]
    assert config["params"] == {"limit": 0.4, "file": "in.txt", "pair": [2, 3]}
    assert config["recipes"]["r"][1] == {
        "stage": "check.limit", "id": "check.limit", "maximum": "${limit}", "soft": False
    }  # fmt: skip
    varied = config["pipeline"][1]
    assert varied["file"] == "${file}"
    assert varied["length"] == "50.0 um"
    assert varied["numbers"] == [0.1, 0.001]
    assert varied["whole"] == 1
    assert "maybe" not in varied


def test_a_stage_chosen_by_a_parameter_keeps_what_was_written(work):
    text = "params: {s: read.whole}\npipeline: [{stage: '${s}', value: 5}]\n"
    assert work.run(text)["config"]["pipeline"] == [{"stage": "${s}", "id": "read.whole", "value": 5}]


def test_until_stops_after_a_stage(work):
    record = work.run(CHAIN, until="field.scale")
    assert [entry["id"] for entry in record["stages"]] == ["sample.random", "field.scale"]
    assert record["until"] == "field.scale"
    with pytest.raises(ConfigError, match=r"did you mean 'field\.scale'"):
        work.run(CHAIN, until="field.sacle", to="other")
    assert not (work.folder / "other").exists()


@pytest.mark.parametrize(
    ("how", "kind", "code", "words"),
    [
        ("value", SppmError, 1, "internal error: raised ValueError: this stage always fails"),
        ("design", DesignError, 3, "impossible"),
        ("memory", ResourceError, 5, "not enough memory"),
        ("disk", ResourceError, 5, "No space left on device: 'big.bin'"),
        ("missing", InputError, 3, "No such file or directory: 'in.stl'"),
        ("wrong_type", SppmError, 1, "made Text, but announces Number"),
        ("inconsistent", SppmError, 1, "made a Number that contradicts itself: not a number"),
        ("no_output", PluginError, 4, "announced but not written"),
        ("escape", ConfigError, 2, "leaves the run directory"),
        ("bad_report", SppmError, 1, "object can't be written as JSON"),
    ],
)
def test_errors_have_a_place_a_stage_and_an_offender(work, how, kind, code, words):
    with pytest.raises(kind) as caught:
        work.run(f"pipeline:\n  - {{stage: check.fail, id: bad, how: {how}}}\n")
    error = caught.value
    assert type(error) is kind
    assert error.exit_code == code
    assert words in error.message
    assert error.stage == "bad"
    assert str(error.where) == f"{work.folder / 'config.yaml'}:3:13"
    record = json.loads((work.folder / "out" / "run.json").read_text())
    assert record["status"] == "failed"
    assert record["error"]["message"] == error.message
    assert record["error"]["exit_code"] == code
    assert [p.name for p in (work.folder / "out").iterdir()] == ["run.json"]


def test_an_interrupted_run_leaves_no_half_files(work):
    with pytest.raises(KeyboardInterrupt):
        work.run("pipeline: [{stage: check.fail, how: interrupt}]\n")
    assert [p.name for p in (work.folder / "out").iterdir()] == ["run.json"]
    assert json.loads((work.folder / "out" / "run.json").read_text())["status"] == "interrupted"


def test_two_stages_that_write_the_same_file(work):
    with pytest.raises(ConfigError) as caught:
        work.run("pipeline:\n  - read.whole\n  - write.number\n  - write.number\n")
    assert caught.value.stage == "write.number#2"
    assert caught.value.where.line == 5


RECIPE = """recipes:
  r:
    - {stage: sample.random}
    - {stage: check.limit, maximum: 0.02, id: limit}
pipeline:
  - {stage: tune.repeat, recipe: r, attempts: 200}
"""


def test_recipes_are_drawn_again_until_accepted(work):
    (entry,) = work.run(RECIPE)["stages"]
    assert entry["summary"]["value"] <= 0.02
    assert entry["recipes"] == {"recipe": "r"}
    random, limit = entry["inner"]
    assert random["id"] == "r.sample.random"
    assert random["runs"] == entry["summary"]["attempts"] > 1
    assert limit["runs"] == 1
    assert random["summary"]["value"] == entry["summary"]["value"]


def test_different_callers_of_a_recipe_draw_differently(work):
    record = work.run(
        "recipes:\n  r: [sample.random]\npipeline:\n"
        "  - {stage: tune.repeat, id: a, recipe: r}\n  - {stage: tune.repeat, id: b, recipe: r}\n"
    )
    a, b = record["stages"]
    assert a["summary"]["value"] != b["summary"]["value"]


def test_inserting_a_stage_does_not_change_the_random_numbers_of_others(work):
    before = stage(work.run("pipeline: [{stage: sample.random, id: x}]\n"), "x")
    after = stage(work.run("pipeline: [read.varied, {stage: sample.random, id: x}]\n"), "x")
    assert before["summary"] == after["summary"]


@pytest.mark.parametrize("target", ["limit", "check.limit"])
def test_a_stage_can_change_options_of_its_recipe(work, target):
    overrides = [f"tune.target={target}", "tune.option_name=maximum", "tune.value=0.01"]
    (entry,) = work.run(RECIPE, s=overrides)["stages"]
    assert entry["summary"]["value"] <= 0.01


@pytest.mark.parametrize(
    ("stage_", "option", "value", "words"),
    [
        ("limti", "maximum", 1, "did you mean 'limit'"),
        ("limit", "maxumim", 1, "did you mean 'maximum'"),
        ("sample.random", "count", 0, "at least 1"),
        ("sample.random", "count", 1.5, "an integer"),
    ],
)
def test_options_that_a_stage_can_not_change(work, stage_, option, value, words):
    overrides = [f"tune.target={stage_}", f"tune.option_name={option}", f"tune.value={value}"]
    with pytest.raises(ConfigError) as caught:
        work.run(RECIPE, s=overrides)
    assert words in str(caught.value)
    assert caught.value.stage == "tune.repeat"


def test_errors_inside_of_recipes_name_the_stage_inside(work):
    with pytest.raises(Rejected) as caught:
        work.run("pipeline: [sample.random, {stage: check.limit, maximum: -1}]\n")
    assert caught.value.stage == "check.limit"
    with pytest.raises(DesignError) as caught:
        work.run("recipes:\n  r: [{stage: check.fail, how: design}]\npipeline: [{stage: tune.repeat, recipe: r}]\n")
    assert caught.value.stage == "r.check.fail"
    assert caught.value.where.line == 3


def test_results_are_freed_after_their_last_use(work, monkeypatch):
    made: dict[str, weakref.ref] = {}
    alive: list[list[str]] = []

    def watched(cls):
        run = cls.run

        def wrapper(self, context, **inputs):
            alive.append([name for name, ref in made.items() if ref() is not None])
            result = run(self, context, **inputs)
            made[context.address] = weakref.ref(result)
            return result

        monkeypatch.setattr(cls, "run", wrapper)

    plan = work.plan(
        "pipeline:\n  - {stage: read.number, value: 1, id: a}\n  - {stage: read.number, value: 2, id: unused}\n"
        "  - {stage: field.scale, id: b, from: a}\n  - {stage: field.scale, id: c, from: b}\n"
        "  - {stage: field.scale, id: d, from: c}\n"
    )
    for cls in (synthetic.ReadNumber, synthetic.ScaleNumber):
        watched(cls)
    run_plan(plan, work.folder / "out", threads=1)
    assert alive == [[], ["a"], ["a"], ["b"], ["c"]]
    assert last_uses(plan.steps) == [set(), {"unused"}, {"a"}, {"b"}, {"c", "d"}]


def test_the_monitor_is_told(work):
    told = []

    class Telling(Monitor):
        def stage_started(self, stage, number, total):
            told.append(("started", stage, number, total))

        def progress(self, stage, inner, done, total, what):
            told.append(("progress", stage, inner, done, total, what))

        @hookimpl
        def sppm_stage_finished(self, event):
            told.append(("finished", event.address))

        def warning(self, stage, message):
            told.append(("warning", stage, message))

    text = (
        "params: {x: 1}\nrecipes: {r: [read.whole, field.scale]}\n"
        "pipeline: [{stage: tune.repeat, recipe: r}, field.scale]\n"
    )
    run_plan(work.plan(text), work.folder / "out", threads=1, monitor=Telling())
    assert told[0][:2] == ("warning", None)
    assert told[1:] == [
        ("started", "tune.repeat", 1, 2),
        ("progress", "tune.repeat", True, 1, 1, "numbers"),
        ("finished", "tune.repeat"),
        ("started", "field.scale", 2, 2),
        ("progress", "field.scale", False, 1, 1, "numbers"),
        ("finished", "field.scale"),
    ]


def test_json_is_strict_and_plain():
    value = jsonable({"a": np.float64("nan"), "b": np.arange(4).reshape(2, 2), 3: (1, [2.5, np.int8(1)]), "c": {}})
    text = json_text(value)
    assert json.loads(text, parse_constant=lambda name: pytest.fail(name)) == {
        "a": None, "b": [[0, 1], [2, 3]], "3": [1, [2.5, 1]], "c": {}
    }  # fmt: skip
    assert '"b": [\n  [0, 1],\n  [2, 3]\n ]' in text
    with pytest.raises(TypeError):
        jsonable({"x": object()})


def test_a_plan_is_a_function_of_its_arguments(work):
    session = work.session(FULL)
    assert make_plan(session.configuration, session.registry).document == session.plan().document


JUDGE = '''
from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_pipeline.hookspecs import hookimpl
from sppm_pipeline.stage import Context, Recipe, Rejected, Stage, option
from tests.synthetic import Number


@dataclass(frozen=True, kw_only=True)
class Judge(Stage):
    """Write a report, and reject."""

    name: ClassVar[str] = "check.judge"
    report: str = option("report.txt", help="the report", output=True)
    keep: bool = option(True, help="whether it stays")
    write: bool = option(True, help="whether it is written")

    def run(self, context: Context, number: Number) -> Number:
        context.report(found=7)
        path = context.output(self.report)
        if self.write:
            path.write_text("all that is wrong")
        raise Rejected("not good", keep_outputs=self.keep)


@dataclass(frozen=True, kw_only=True)
class Once(Stage):
    """Announce an output of its own, then run a recipe."""

    name: ClassVar[str] = "tune.once"
    notes: str = option("notes.txt", help="notes", output=True)

    def run(self, context: Context, recipe: Recipe) -> Any:
        context.output(self.notes)
        return recipe.run(context)


@hookimpl
def sppm_stages():
    return {"check.judge": Judge, "tune.once": Once}
'''
REJECTED = "pipeline: [sample.random, check.judge, write.number]\n"
INSIDE = """recipes:
  r: [sample.random, {stage: write.number, path: inside.txt}, {stage: check.judge, from: sample.random}]
pipeline: [{stage: %s, recipe: r}]
"""


@pytest.fixture
def judge(tmp_path):
    path = tmp_path / "judge.py"
    path.write_text(JUDGE)
    return path


@pytest.mark.parametrize(("text", "at"), [(REJECTED, "check.judge"), (INSIDE % "tune.once", "tune.once")])
def test_what_rejects_may_keep_its_report(work, judge, text, at):
    heard = []

    class Hearing(Monitor):
        @hookimpl
        def sppm_stage_finished(self, event):
            heard.append(event)

    plan = work.plan(text, plugins=[judge])
    with pytest.raises(Rejected) as caught:
        run_plan(plan, work.folder / "out", threads=1, monitor=Hearing())
    assert files_in(work.folder / "out") == ["SHA256SUMS", "report.txt", "run.json"]
    assert heard[-1].failed
    assert "not good" in heard[-1].error
    entry = caught.value.record["stages"][-1]
    assert entry == heard[-1].record
    assert (entry["id"], entry["rejected"]) == (at, True)
    assert [output["path"] for output in entry["outputs"]] == ["report.txt"]
    assert at != "check.judge" or entry["summary"] == {"found": 7}
    assert verify_run(work.folder / "out")[0] == []


@pytest.mark.parametrize("text", [REJECTED, INSIDE % "tune.once", INSIDE % "tune.repeat"])
def test_what_rejects_keeps_nothing_else(work, judge, text):
    keep = () if "repeat" in text else ("r.check.judge.keep=false" if "once" in text else "check.judge.keep=false",)
    with pytest.raises(DesignError) as caught:
        work.run(text, plugins=[judge], s=keep)
    assert files_in(work.folder / "out") == ["run.json"]
    assert all(entry["id"] == "sample.random" for entry in caught.value.record["stages"])


def test_a_report_that_is_kept_is_there(work, judge):
    with pytest.raises(PluginError, match="announced but not written") as caught:
        work.run(REJECTED, plugins=[judge], s=["check.judge.write=false"])
    assert caught.value.stage == "check.judge"


def test_a_link_that_leads_to_itself_is_no_file(tmp_path):
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "file").write_text("x")
    (tmp_path / "loop").symlink_to("loop")
    assert files_in(tmp_path) == ["inside/file"]
