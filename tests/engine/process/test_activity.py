"""What a process notes for its supervisor."""

import math
import os
import select
import time
import warnings

import pytest

from sppm_pipeline.engine.process import activity, containment
from sppm_pipeline.engine.process.activity import Activity, doing
from sppm_pipeline.errors import PluginError


@pytest.fixture
def shared(monkeypatch):
    monkeypatch.setattr(activity, "_shared", None)
    monkeypatch.setattr(activity, "_times", activity._times)
    monkeypatch.setattr(activity, "_active", [])
    activity.share()


def test_the_earliest_deadline_of_what_is_being_done_holds(shared):
    assert activity.deadlines() == (math.inf, math.inf)
    now = time.monotonic()
    activity.limit_run(500)
    with doing(Activity("outer", True), 100), doing(Activity("inner", False, "a.yaml:3:1", "cut"), 200):
        run, stage = activity.deadlines()
        assert (run - now, stage - now) == pytest.approx((500, 100), abs=20)
        assert activity.current() == Activity("inner", False, "a.yaml:3:1", "cut")
        assert not activity.was_left()
    assert activity.current() is None
    assert activity.deadlines() == (run, math.inf)


def test_the_supervisor_waits_longer_than_the_stage_and_its_own_process(shared, monkeypatch):
    monkeypatch.setenv(containment.STAGE_TIME, "5e5")
    monkeypatch.setattr(containment, "GRACE", 1e7)
    monkeypatch.setattr(containment, "LAST", 1e6)
    with containment.limited("somebody", builtin=False):
        assert activity.deadlines()[1] - time.monotonic() == pytest.approx(11.5e6, abs=1e4)


def test_of_two_limits_the_one_that_is_up_is_told(monkeypatch):
    def work():
        with containment.limited("the outer one", builtin=False):
            monkeypatch.setenv(containment.STAGE_TIME, "1e5")
            with containment.limited("the inner one", builtin=False):
                until = time.monotonic() + 60
                while time.monotonic() < until:
                    time.sleep(0.01)

    monkeypatch.setenv(containment.STAGE_TIME, "0.2")
    with pytest.raises(PluginError, match="the outer one took longer"):
        work()


def test_of_too_long_a_text_the_end_is_cut(shared):
    with doing(Activity("ü" * 5000, True, "a.yaml:3:1", "cut")):
        now = activity.current()
    assert now[1:] == (True, "a.yaml:3:1", "cut", "stage")
    assert now.what.startswith("ü" * 2000)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that fork")
def test_a_supervisor_never_sees_a_deadline_that_nobody_has_set(shared):
    begun, over = os.pipe(), os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of forks while there are threads, as from Python 3.12
        child = os.fork()
    if child == 0:
        os.close(over[1])
        os.write(begun[1], b"!")
        while not select.select([over[0]], [], [], 0)[0]:
            for _ in range(100):
                with doing(Activity("something", True)):
                    pass
        activity.leave(0)
    os.read(begun[0], 1)
    seen = {activity.deadlines() for _ in range(100_000)}  # for half a second
    for end in (*over, *begun):
        os.close(end)
    assert os.waitpid(child, 0)[1] == 0
    assert seen == {(math.inf, math.inf)}
    assert activity.was_left()
