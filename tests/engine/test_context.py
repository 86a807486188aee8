"""Random numbers depend on seed, path, attempt and key, and on nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.engine.cache.store import Store
from sppm_pipeline.engine.run.context import RunContext, StageLog, generator
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.testing.plain_context import PlainContext


def draw(seed=1, path=("a",), key=()):
    return generator(seed, path, key).integers(1 << 62)


def test_the_generator_is_a_function_of_its_arguments():
    assert draw() == draw()
    # pinned: kept results and published seeds must stay valid
    assert draw(7, ("sample.dart_throwing",), (3,)) == 1745265327120921577


def test_any_difference_gives_other_numbers():
    draws = [
        draw(),
        draw(seed=2),
        draw(path=("b",)),
        draw(path=("a", "")),
        draw(path=("", "a")),
        draw(key=(0,)),
        draw(key=(0, 0)),
        draw(key=(1 << 32,)),
        draw(key=(0, 1)),
        draw(key=(-1,)),
        draw(seed=11, path=("a",), key=(1,)),
        draw(seed=1, path=("a",), key=(11,)),
        draw(path=("a", "1"), key=()),
        draw(path=("a",), key=(1,)),
    ]
    assert len(set(draws)) == len(draws)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(st.integers(0, 1 << 70), st.lists(st.text(max_size=4), max_size=3), st.lists(st.integers(), max_size=3))
def test_any_seed_and_key_is_accepted(seed, path, key):
    assert draw(seed, tuple(path), tuple(key)) == draw(seed, tuple(path), tuple(np.array(key, object)))


def test_keys_are_whole_numbers():
    assert PlainContext(1).rng(np.int64(3)).random() == PlainContext(1).rng(3).random()
    with pytest.raises(TypeError):
        PlainContext(1).rng(0.5)


def test_stages_of_recipes_have_their_own_path():
    outer = PlainContext(1, stage="outer")
    inner = [outer.inside("cell", attempt, "s", "cell.s", outer.palette) for attempt in (0, 1)]
    draws = {context.rng().integers(1 << 62) for context in [outer, *inner]}
    assert len(draws) == 3
    nested = inner[1].inside("cell", 0, "s", "cell.s", outer.palette)
    assert nested.path == ("outer", "cell@1", "s", "cell@0", "s")


def test_reports_are_plain_json():
    context = PlainContext()
    context.report(a=np.float32(0.5), b=np.arange(3), c=(1, 2), d=float("nan"), e=np.bool_(True), f=None)
    assert context.reported == {"a": 0.5, "b": [0, 1, 2], "c": [1, 2], "d": None, "e": True, "f": None}
    with pytest.raises(TypeError):
        context.report(bad=object())


def test_a_warning_is_told_once():
    class Counting(Monitor):
        told = 0

        def warning(self, stage, message):
            self.told += 1

    monitor = Counting()
    log = StageLog(monitor, "s")
    log.warn("s", "x")
    log.warn("s", "x")
    log.warn("t", "x")
    assert monitor.told == 2
    assert log.warnings == [("s", "x"), ("t", "x")]


def test_unfinished_work_is_remembered_until_it_is_forgotten(tmp_path):
    def context(store):
        log = StageLog(Monitor(), "a")
        return RunContext(
            seed=1, path=("a",), address="a", threads=1, palette=Palette(), log=log, folder=None, store=store
        )

    first = context(Store(tmp_path))
    assert first.recall("key") is None
    first.remember("key", {"step": 3, "x": np.arange(5.0)})
    first.remember("key", {"step": 4, "x": np.arange(6.0)})
    found = context(Store(tmp_path)).recall("key")
    assert found["step"] == 4
    assert np.array_equal(found["x"], np.arange(6.0))
    assert first.recall("other") is None
    first.remember("key", None)
    assert context(Store(tmp_path)).recall("key") is None
    nowhere = context(None)
    nowhere.remember("key", 1)
    assert nowhere.recall("key") is None
