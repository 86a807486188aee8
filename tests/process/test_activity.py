"""What a process notes for its supervisor."""

import math
import os
import time

import pytest

from sppm_pipeline.process import activity
from sppm_pipeline.process.activity import Activity, doing


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


def test_of_too_long_a_text_the_end_is_cut(shared):
    with doing(Activity("ü" * 5000, True, "a.yaml:3:1", "cut")):
        now = activity.current()
    assert now[1:] == (True, "a.yaml:3:1", "cut")
    assert now.what.startswith("ü" * 2000)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that fork")
def test_a_supervisor_never_sees_a_deadline_that_nobody_has_set(shared):
    child = os.fork()
    if child == 0:
        until = time.monotonic() + 0.5
        while time.monotonic() < until:
            with doing(Activity("something", True)):
                pass
        activity.leave(0)
    seen = set()
    while not os.waitpid(child, os.WNOHANG)[0]:
        for _ in range(200):
            seen.add(activity.deadlines())
    assert seen == {(math.inf, math.inf)}
    assert activity.was_left()
