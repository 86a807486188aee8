"""The peak of memory of what goes on, not of all that went before."""

import mmap
import threading
import time

import pytest

from sppm_pipeline.engine.process import resident
from sppm_pipeline.engine.process.budget import held_memory
from sppm_pipeline.engine.process.resident import PeakWatch


def held(megabytes):
    """Memory that nobody had before; what numpy is given may be what something else has left, which is resident."""
    area = mmap.mmap(-1, megabytes * 10**6)
    for at in range(0, len(area), mmap.PAGESIZE):
        area[at] = 1
    return area


def taken(megabytes):
    """The peak while so much is held, above what was there before; held until the thread has looked, for a minute."""
    before = held_memory()[0]
    with PeakWatch() as watch, held(megabytes):
        until = time.monotonic() + 60
        while watch.most < before + 0.9e6 * megabytes and time.monotonic() < until:
            time.sleep(0.01)
    return watch.mb - before / 1e6


def test_each_has_its_own_peak():
    first = taken(300)
    assert 270 < first < 340
    assert 80 < taken(100) < 140  # less than the highest so far: seen by looking
    before = held_memory()[0] / 1e6
    with PeakWatch() as watch:
        time.sleep(3 * resident.PERIOD)
    assert watch.mb - before < 30


def test_a_new_peak_is_exact_however_short(monkeypatch):
    monkeypatch.setattr(resident, "_look", lambda: None)
    before = resident.highest() / 1e6
    above = int(before - held_memory()[0] / 1e6) + 200
    with PeakWatch() as watch:
        held(above).close()
    assert before + 150 < watch.mb < before + 250


@pytest.mark.parametrize(("first", "last"), [(5e6, 3e6), (3e6, 5e6)])
def test_beginning_and_end_are_looked_at_whatever_the_thread_does(monkeypatch, first, last):
    now = [first]
    monkeypatch.setattr(resident, "_look", lambda: None)
    monkeypatch.setattr(resident, "highest", lambda: 10**10)
    monkeypatch.setattr(resident, "held_memory", lambda: (now[0], 0))
    with PeakWatch() as watch:
        now[0] = last
    assert watch.mb == 5


def test_the_thread_ends_by_itself(monkeypatch):
    monkeypatch.setattr(resident, "LINGER", 0.1)
    taken(20)
    until = time.monotonic() + 60
    while resident._thread is not None and time.monotonic() < until:
        time.sleep(0.01)
    assert not [one for one in threading.enumerate() if one.name == "sppm-memory"]
    assert taken(60) > 40  # another one is started


def test_a_watch_that_begins_as_the_thread_ends_is_looked_at(monkeypatch):
    monkeypatch.setattr(resident, "LINGER", 0.0)
    monkeypatch.setattr(resident, "PERIOD", 0.0)  # the thread ends at its first look that finds nobody
    for _ in range(300):
        with PeakWatch() as watch:
            watch.most = 0
            until = time.monotonic() + 60
            while not watch.most and time.monotonic() < until:
                time.sleep(0)
            assert watch.most
