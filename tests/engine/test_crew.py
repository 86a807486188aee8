"""Workers of a single run: what stages map comes back in order, whoever dies meanwhile."""

from __future__ import annotations

import functools
import operator
import os
import time
from concurrent.futures import Executor, Future
from contextlib import nullcontext
from pathlib import Path

import pytest

from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.process import interruption
from sppm_pipeline.engine.run import crew as crew_module
from sppm_pipeline.engine.run import workers as items_module
from sppm_pipeline.engine.run.crew import WorkerPool
from sppm_pipeline.engine.run.events import Monitor
from sppm_pipeline.engine.run.executors import WorkerOptions
from sppm_pipeline.engine.run.runner import run_plan
from sppm_pipeline.engine.run.workers import Driver, name_of
from sppm_pipeline.errors import ConfigError, NativeCrash, PluginError
from sppm_pipeline.nouns.storage import NotStorable
from sppm_pipeline.testing.plain_context import PlainContext

PLUGIN = '''
import os, signal, time
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
import numpy as np
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.stage import Context, Stage, option

LOADED = []

@dataclass(frozen=True, eq=False)
class Base(Artifact):
    """What all items have in common."""
    values: np.ndarray
    folder: str

    def __post_init__(self):
        LOADED.append(os.getpid())

def power(common, item):
    number, how = item
    if how == "kill" and number == 3 and len(list(Path(common.folder).glob("died-*"))) < 1:
        Path(common.folder, f"died-{os.getpid()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "always" and number == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "raise" and number == 3:
        raise ValueError("three is too much")
    if how == "wait":
        Path(common.folder, f"pid-{os.getpid()}").touch()
        time.sleep(600)
    if how == "slow" and number == 0:
        time.sleep(0.3)
    return common.values ** number, os.getpid(), LOADED.count(os.getpid())

@dataclass(frozen=True, kw_only=True)
class Mapped(Stage):
    """Powers of two numbers."""
    name: ClassVar[str] = "check.mapped"
    how: str = option("", help="what happens on the way")
    folder: str = option(help="where notes go")

    def run(self, context: Context) -> None:
        base = Base(np.array([2.0, 3.0]), self.folder)
        made = list(context.map(power, [(n, self.how) for n in range(7)], base))
        context.report(sums=[float(values.sum()) for values, *_ in made], hosts=len({pid for _, pid, _ in made}),
                       loaded=max(loads for *_, loads in made), here=any(pid == os.getpid() for _, pid, _ in made),
                       workers=context.workers)
'''
SUMS = [float(2**n + 3**n) for n in range(7)]


class Heard(Monitor):
    def __init__(self):
        self.texts = []

    def crew_started(self, about):
        self.texts.append(about)

    def warning(self, stage, message):
        self.texts.append(message)


def run(work, how, *, workers=2, retries=2, executor=None, heard=None):
    folder = work.folder
    (folder / "mapped.py").write_text(PLUGIN)
    text = f"pipeline: [{{stage: check.mapped, id: m, how: '{how}', folder: '{folder}'}}]"
    session = work.session(text, plugins=[folder / "mapped.py"])
    crew = None
    if workers:
        crew = WorkerPool(
            session.plugins, folder / "out",
            WorkerOptions(executor=executor, workers=workers, threads=4, retries=retries), monitor=heard,
        )  # fmt: skip
    record = run_plan(session.plan(), folder / "out", threads=2, crew=crew)
    assert [path.name for path in (folder / "out").iterdir()] == ["run.json"]  # nothing of the workers is left
    return record["stages"][0]["summary"]


@pytest.mark.parametrize("how", ["slow", "kill"])
def test_results_come_in_order_whoever_makes_them(work, how):
    heard = Heard()
    found = run(work, how, heard=heard)
    assert found["sums"] == SUMS
    assert not found["here"]
    assert found["workers"] == 2
    assert found["loaded"] == 1  # by each worker, once
    assert heard.texts[0] == "2 processes"
    assert heard.texts[1:] == (["a worker process died; its work is handed out again"] if how == "kill" else [])


def test_without_workers_threads_of_this_process_do_it(work):
    found = run(work, "", workers=0)
    assert found["sums"] == SUMS
    assert found["here"]
    assert found["workers"] == 0


def test_an_item_that_kills_each_worker_ends_the_run(work):
    with pytest.raises(NativeCrash, match="a worker process died, 2 times of the same work") as caught:
        run(work, "always", retries=1)
    assert caught.value.stage == "m"


def test_what_an_item_raises_is_raised(work):
    with pytest.raises(PluginError, match="ValueError: three is too much"):
        run(work, "raise")


def test_an_interrupt_ends_the_workers(work, monkeypatch):
    def soon():
        if list(work.folder.glob("pid-*")):
            interruption.request()
        check()

    check = crew_module.check
    monkeypatch.setattr(crew_module, "check", soon)
    try:
        with pytest.raises(KeyboardInterrupt):
            run(work, "wait")
    finally:
        interruption.reset()
    for file in work.folder.glob("pid-*"):
        with pytest.raises(ProcessLookupError):
            os.kill(int(file.name[4:]), 0)


class Here(Executor):
    """Does all at once, and may lose something."""

    lost: tuple[BaseException, ...] = ()

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        if Here.lost:
            error, *rest = Here.lost
            Here.lost = tuple(rest)
            future.set_exception(error)
        else:
            try:
                future.set_result(fn(*args, **kwargs))
            except Exception as error:
                future.set_exception(error)
        return future


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A crew of this process."""
    plugins = load_plugins(["sppm_pipeline.engine.run.executors"], distributions=False)
    plugins.plugins[0].executors["here"] = lambda workers: Here()
    monkeypatch.setattr(Here, "lost", ())
    crew = WorkerPool(plugins, tmp_path / "run", WorkerOptions(executor="here", workers=2, threads=5, retries=1))
    yield crew
    crew.close()
    assert not list((tmp_path / "run").iterdir())


def test_what_is_common_is_written_once(here, tmp_path):
    common = (2, Path("a"))
    assert list(here.map(operator.mul, range(3), 2)) == [0, 2, 4]
    assert list(here.map(operator.contains, [Path("a"), 3], common)) == [True, False]
    assert list(here.map(operator.contains, iter([2]), common)) == [True]
    assert len(list((tmp_path / "run").glob(".*/*/value.json"))) == 2
    assert here.threads == 2


def test_all_that_calls_of_a_stage_had_in_common_goes_with_it(here, tmp_path):
    for common in ((1, 2), (3, 4), (5, 6)):
        assert list(here.map(operator.contains, [3], common)) == [3 in common]
    assert len(list((tmp_path / "run").glob(".*/*/value.json"))) == 3
    here.forget()
    assert not list((tmp_path / "run").glob(".*/*/value.json"))


def test_what_is_common_goes_with_its_stage(here, tmp_path, monkeypatch):
    common = (2, Path("a"))
    monkeypatch.setattr(items_module, "IDLE", 600)
    items_module._loaded.cache_clear()
    assert list(here.map(operator.contains, [Path("a")], common)) == [True]
    assert items_module._loaded.cache_info().currsize == 1
    monkeypatch.setattr(items_module, "IDLE", 0.05)
    assert list(here.map(operator.contains, [Path("a")], common)) == [True]
    deadline = time.monotonic() + 60
    while items_module._loaded.cache_info().currsize and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not items_module._loaded.cache_info().currsize
    assert list((tmp_path / "run").glob(".*/*/value.json"))
    here.forget()
    assert not list((tmp_path / "run").glob(".*/*/value.json"))
    here.forget()
    assert list(here.map(operator.contains, [3], common)) == [False]  # written anew


def test_what_is_common_stays_while_an_item_is_in_work(monkeypatch):
    timers = []

    class Timer:
        def __init__(self, seconds, function):
            self.function, self.daemon, self.canceled = function, False, False

        def start(self):
            timers.append(self)

        def cancel(self):
            self.canceled = True

    monkeypatch.setattr(items_module.threading, "Timer", Timer)
    monkeypatch.setattr(items_module, "_idle", None)
    monkeypatch.setattr(items_module, "_loaded", functools.lru_cache(maxsize=1)(lambda kept: kept))
    with items_module._at_work():
        items_module._loaded(1)
        with items_module._at_work():
            pass
        assert timers == []
        items_module._forget_if_idle()  # as a timer does that has gone off just before
        assert items_module._loaded.cache_info().currsize == 1
    with items_module._at_work():
        assert timers[0].canceled
    timers[1].function()
    assert items_module._loaded.cache_info().currsize == 0
    assert len(timers) == 2


def test_items_are_taken_as_they_are_needed(here):
    taken = []
    coming = here.map(operator.add, (taken.append(n) or n for n in range(100)), 1)
    assert next(coming) == 1
    assert len(taken) <= 2 * 2 + 1
    coming.close()


def test_what_the_executor_loses_is_done_again_or_said(here):
    Here.lost = (NativeCrash("the worker died"), NativeCrash("the worker died"))
    assert list(here.map(operator.add, [1, 2, 3], 1)) == [2, 3, 4]
    Here.lost = (NativeCrash("the worker died"),) * 9
    with pytest.raises(NativeCrash, match="2 times of the same work: the worker died"):
        list(here.map(operator.add, [1, 2, 3], 1))
    Here.lost = (ConnectionError("the scheduler is gone"),)
    with pytest.raises(PluginError, match="lost work: ConnectionError: the scheduler is gone"):
        list(here.map(operator.add, [1], 1))


def test_what_can_not_travel_is_refused(here):
    def inner(common, item):
        return item

    for function in (inner, lambda common, item: item, here.close):
        with pytest.raises(TypeError, match="a function of a module that workers can import"):
            next(here.map(function, [1], 1))
        with pytest.raises(TypeError, match="a function of a module"):
            PlainContext(workers=1).map(function, [1], 1)
    with pytest.raises(NotStorable):
        next(here.map(operator.add, [1], object()))
    assert name_of(os.path.join) == "posixpath:join"


def test_a_worker_of_another_version_is_refused(here, monkeypatch):
    with_driver = here.map(operator.add, [1], 1)
    monkeypatch.setattr(crew_module, "announced", lambda *args, **how: nullcontext(stranger))
    stranger = Driver("head", "0123456789abcdef", (("numpy", "0.9"),), (), "")
    with pytest.raises(ConfigError, match=r"is not that of head: .*instead of 0\.9"):
        next(with_driver)


def test_executors_of_this_process_are_no_crew():
    assert [WorkerOptions(executor=name, workers=workers).apart for name, workers in (
        (None, 1), (None, 2), ("serial", 4), ("threads", 4), ("processes", 1), ("dask:tcp://head:8786", 1)
    )] == [False, True, False, False, True, True]  # fmt: skip
