"""The hook `sppm_stage_finished`: what observers hear, and that they change nothing."""

from __future__ import annotations

import json

import pytest

from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.errors import SppmError

OBSERVER = """
from sppm_pipeline.hookspecs import hookimpl

heard = []


@hookimpl
def sppm_stage_finished(event):
    heard.append(event)
"""
TEXT = (
    "recipes: {r: [read.whole, field.scale]}\n"
    "pipeline: [{stage: tune.repeat, id: best, recipe: r}, field.scale, write.number]"
)


class Warnings(Monitor):
    def __init__(self):
        self.heard = []

    def warning(self, stage, message):
        self.heard.append((stage, message))


@pytest.fixture
def observer(work):
    return work.write(OBSERVER, "observer.py")


def heard_by(plan):
    return next(plugin.module.heard for plugin in plan.plugins if plugin.name.endswith("observer.py"))


def test_every_stage_of_the_pipeline_is_an_event(work, observer):
    plan = work.plan(TEXT, plugins=[observer])
    record = run_plan(plan, work.folder / "out", threads=1)
    events = heard_by(plan)
    assert [(e.address, e.stage, e.made) for e in events] == [
        ("best", "tune.repeat", "Number"),
        ("field.scale", "field.scale", "Number"),
        ("write.number", "write.number", None),
    ]
    assert [dict(event.record) for event in events] == record["stages"]
    assert [dict(event.summary) for event in events] == [stage["summary"] for stage in record["stages"]]
    assert events[0].record["inner"][0]["runs"] == 1
    assert not any(event.failed or event.from_cache for event in events)
    with pytest.raises(TypeError):
        events[0].record["summary"] = {}


def test_a_stage_that_fails_is_an_event_as_well(work, observer):
    plan = work.plan("pipeline: [read.whole, {stage: check.limit, maximum: 1}]", plugins=[observer])
    with pytest.raises(SppmError):
        run_plan(plan, work.folder / "out", threads=1)
    good, bad = heard_by(plan)
    assert not good.failed
    assert bad.failed
    assert "stage 'check.limit'" in bad.error
    assert (bad.made, dict(bad.record)) == (None, {})


def test_a_stage_from_the_cache_is_marked(work, observer, monkeypatch):
    from sppm_pipeline.engine.cache import session
    from sppm_pipeline.engine.cache.store import Store

    monkeypatch.setattr(session, "MAX_OVERHEAD", 1000.0)
    plan = work.plan("pipeline: [sample.random, field.scale]", plugins=[observer])
    for to in ("one", "two"):
        run_plan(plan, work.folder / to, threads=1, store=Store(work.folder / "cache"))
    assert [event.from_cache for event in heard_by(plan)] == [False, False, True, True]


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("raise ValueError('no')", "raised ValueError: no"),
        ("raise SystemExit(3)", "tried to end the program"),
        ("event.record['summary'] = {}", "raised TypeError"),
    ],
)
def test_an_observer_that_raises_is_a_warning_and_changes_nothing(work, observer, body, words):
    bad = work.write(OBSERVER.replace("heard.append(event)", body), "bad.py")
    monitor = Warnings()
    plan = work.plan(TEXT, plugins=[bad, observer])
    record = run_plan(plan, work.folder / "out", threads=1, monitor=monitor)
    assert len(monitor.heard) == 1
    assert monitor.heard[0][0] is None
    assert f"the plugin {bad}: sppm_stage_finished {words}" in monitor.heard[0][1]
    assert record["warnings"] == [monitor.heard[0][1].replace(f"{work.folder}/", "")]
    assert json.loads((work.folder / "out" / "run.json").read_text())["warnings"] == record["warnings"]
    assert len(heard_by(plan)) == 3
    without = work.run(TEXT, to="without")
    assert [stage["summary"] for stage in record["stages"]] == [stage["summary"] for stage in without["stages"]]
    assert (work.folder / "out" / "number.txt").read_bytes() == (work.folder / "without" / "number.txt").read_bytes()


def test_an_observer_may_take_no_argument(work):
    path = work.write(OBSERVER.replace("(event)", "()", 1).replace("append(event)", "append(1)"), "observer.py")
    plan = work.plan(TEXT, plugins=[path])
    run_plan(plan, work.folder / "out", threads=1)
    assert heard_by(plan) == [1, 1, 1]


def test_an_observer_with_another_argument_is_a_broken_contract(work):
    path = work.write(OBSERVER.replace("(event)", "(color)", 1), "observer.py")
    with pytest.raises(SppmError, match="color"):
        work.plan(TEXT, plugins=[path])
