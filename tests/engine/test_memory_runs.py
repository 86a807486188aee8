"""Runs without a run directory, and configurations that are no files: what the Python face is built on."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.engine.cache import session as cache_session
from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.plan.session import RunRequest, open_session
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.strict_json import jsonable
from sppm_pipeline.errors import ConfigError, ConfigErrors
from sppm_pipeline.nouns.length import Length
from tests.synthetic import Number

TEXT = "seed: 4\npipeline: [sample.random, field.scale, {stage: extract.text, id: words}, write.number]"
SYNTHETIC = ("tests.synthetic",)


def files_below(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_all_results_are_there_and_nothing_is_written(work, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = files_below(tmp_path) | {"config.yaml": b""}
    run = run_in_memory(work.plan(TEXT), threads=1)
    first, second = run.result("sample.random"), run.result("field.scale")
    assert isinstance(first, Number)
    assert second.value == 2 * first.value
    assert run.result("words").text
    assert run.result("write.number") is None
    assert set(files_below(tmp_path)) == set(before)
    assert [stage["id"] for stage in run.record["stages"] if stage.get("skipped")] == ["write.number"]
    with pytest.raises(ConfigError, match=r"no stage 'word'[\s\S]*did you mean 'words'"):
        run.result("word")


def test_the_record_is_that_of_a_run_into_a_directory(work):
    plan = work.plan(TEXT)
    run, record = run_in_memory(plan, threads=1), run_plan(plan, work.folder / "out", threads=1)
    json.dumps(jsonable(run.record), allow_nan=False)
    # digests are of files, and an audit compares mostly numbers of what was written
    assert set(record) - set(run.record) == {"sha256", "sums", "audit"}
    for mine, other in zip(run.record["stages"][:-1], record["stages"], strict=False):
        assert (mine["id"], mine["summary"], mine.get("options", {})) == (
            other["id"],
            other["summary"],
            other.get("options", {}),
        )


@pytest.mark.parametrize("share", [1000.0, 0.0])
def test_results_from_the_cache_are_there_as_well(work, monkeypatch, share):
    monkeypatch.setattr(cache_session, "MAX_OVERHEAD", share)
    monkeypatch.setattr(cache_session, "MIN_SECONDS", 0.0)
    plan = work.plan(TEXT)
    fresh = run_in_memory(plan, threads=1, store=Store(work.folder / "cache"))
    again = run_in_memory(plan, threads=1, store=Store(work.folder / "cache"))
    if share:
        assert [stage.get("cached", False) for stage in again.record["stages"]] == [True, True, True, False]
    for id_ in ("words", "field.scale", "sample.random"):
        assert again.result(id_) == fresh.result(id_)
    assert not list((work.folder / "cache").glob("tmp/*"))


def test_a_run_in_memory_is_saved_without_running_again(work, monkeypatch):
    plan = work.plan(TEXT)
    run = run_in_memory(plan, threads=1)
    ran = []
    from sppm_pipeline.engine.run import runner

    real = runner.run_step
    monkeypatch.setattr(runner, "run_step", lambda step, *rest: ran.append(step.id) or real(step, *rest))
    record = run_plan(plan, work.folder / "saved", threads=1, earlier=run.runner)
    assert ran == ["write.number"]
    monkeypatch.undo()
    direct = run_plan(plan, work.folder / "direct", threads=1)
    assert (work.folder / "saved/number.txt").read_bytes() == (work.folder / "direct/number.txt").read_bytes()
    assert [stage["summary"] for stage in record["stages"]] == [stage["summary"] for stage in direct["stages"]]


def test_until_and_errors_are_as_in_a_directory(work):
    run = run_in_memory(work.plan(TEXT), threads=1, until="field.scale")
    assert [stage["id"] for stage in run.record["stages"]] == ["sample.random", "field.scale"]
    with pytest.raises(ConfigError, match="no stage 'x'"):
        run_in_memory(work.plan(TEXT), threads=1, until="x")


def test_text_is_a_configuration_with_places_in_it(tmp_path):
    request = RunRequest(
        "design", SYNTHETIC, distributions=False, text="sppm: 1\npipeline: [{stage: read.whole, value: x}]"
    )
    with pytest.raises(ConfigError) as caught:
        open_session(request).plan()
    assert str(caught.value).startswith("design:2:39: stage 'read.whole': option 'value'")
    request = RunRequest(
        "design", SYNTHETIC, distributions=False, text="sppm: 1\npipeline: [{stage: read.varied, file: in.txt}]",
        folder=str(tmp_path),
    )  # fmt: skip
    plan = open_session(request).plan()
    assert plan.steps[0].stage.file == tmp_path / "in.txt"
    assert plan.name == "design"
    assert plan.document["folder"] == str(tmp_path)


def test_plain_values_are_a_configuration_as_well(tmp_path):
    document = {
        "sppm": 1,
        "params": {"size": Length(3.0, "um")},
        "pipeline": [
            "read.whole",
            {"stage": "read.varied", "length": "${size}", "file": Path("in.txt"), "pair": np.array([1.0, 2.0])},
        ],
    }
    request = RunRequest("design", SYNTHETIC, distributions=False, document=document, folder=str(tmp_path))
    assert hash(request) == hash(pickle.loads(pickle.dumps(request)))
    plan = open_session(request).plan()
    varied = plan.steps[1].stage
    assert (varied.length, varied.file, varied.pair) == (Length(3.0, "um"), tmp_path / "in.txt", (1.0, 2.0))
    json.dumps(plan.document)
    again = open_session(RunRequest("design", SYNTHETIC, distributions=False, document=plan.document)).plan()
    assert again.document == plan.document


def test_errors_in_plain_values_name_the_path_to_the_value():
    document = {"sppm": 1, "pipeline": [{"stage": "read.whole", "value": "x"}, {"stage": "read.number", "valeu": 1}]}
    with pytest.raises(ConfigErrors) as caught:
        open_session(RunRequest("design", SYNTHETIC, distributions=False, document=document)).plan()
    places = [str(error.where) for error in caught.value.errors]
    assert "design: pipeline[0].value" in places
    assert "design: pipeline[1].valeu" in places
    assert all(":0" not in str(error) for error in caught.value.errors)


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (object(), "can't hold object"),
        ({1: 2}, "keys must be strings"),
        ("a\x00b", "is not allowed in a string"),
        ("x" * 5000, "longer than 4096"),
        (np.zeros(30_000), "more than 20000 values"),
    ],
)
def test_values_that_no_file_can_hold_are_refused(value, words):
    document = {"sppm": 1, "params": {"a": value}, "pipeline": ["read.whole"]}
    with pytest.raises(ConfigError, match=words):
        RunRequest("design", document=document).read()


def test_nesting_without_end_is_refused():
    deep: list = []
    deep.append(deep)
    with pytest.raises(ConfigError, match="nested deeper than 32 levels"):
        RunRequest("design", document={"sppm": 1, "params": {"a": deep}, "pipeline": ["read.whole"]}).read()
