"""Maps by threads: the order of the items, a bounded number of results, nothing begun after the caller has left."""

import os
import signal
import sys
import threading
import time

import pytest

from sppm_pipeline.services import threads
from sppm_pipeline.services.threads import computed_ahead, in_bands, ordered_map, share_out


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads):
    def slow_at_first(n):
        time.sleep(0.02 if n == 0 else 0.0)
        return n * n

    assert list(ordered_map(slow_at_first, iter(range(40)), threads)) == [n * n for n in range(40)]
    assert list(ordered_map(slow_at_first, [], threads)) == []
    assert list(computed_ahead(iter([3, None, 5]), threads)) == [3, None, 5]


@pytest.mark.parametrize(("ahead", "bound"), [(None, 4), (3, 3)])
def test_only_a_bounded_number_of_results_waits(ahead, bound):
    taken = []
    results = ordered_map(lambda n: n, (taken.append(n) or n for n in range(100)), 2, ahead)
    for number, result in enumerate(results):
        assert result == number
        assert len(taken) <= number + 1 + bound
    assert len(taken) == 100


def test_the_next_item_is_computed_while_one_is_in_use():
    begun = [threading.Event() for _ in range(3)]

    def items():
        for n, event in enumerate(begun):
            event.set()
            yield n

    for n in computed_ahead(items(), 2):
        assert n == 2 or begun[n + 1].wait(60)


@pytest.mark.parametrize("threads", [1, 2])
def test_errors_reach_the_caller_and_cancel_the_rest(threads):
    started = []

    def fails(n):
        started.append(n)
        if n == 3:
            raise ValueError("item 3")
        return n

    with pytest.raises(ValueError, match="item 3"):
        list(ordered_map(fails, range(1000), threads))
    assert len(started) < 20

    def broken():
        yield 1
        raise ValueError("item 2")

    with pytest.raises(ValueError, match="item 2"):
        list(computed_ahead(broken(), threads))


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_each_item_is_called_for_once(threads):
    called = []
    share_out(called.append, range(100), threads)
    assert sorted(called) == list(range(100))
    assert share_out(called.append, [], threads) is None
    bands = []
    in_bands(lambda *band: bands.append(band), 37, threads)
    bands.sort()
    assert [begin for begin, _ in bands] == [0, *(stop for _, stop in bands[:-1])]
    assert bands[-1][1] == 37


def test_threads_work_at_once_and_calls_may_be_nested():
    meeting = threading.Barrier(3, timeout=30)
    inner = []

    def outer(number):
        meeting.wait()  # all three at once
        share_out(lambda n: inner.append((number, n)), range(5), 3)

    for _ in range(2):
        share_out(outer, range(3), 3)
    assert sorted(inner) == sorted([(a, b) for a in range(3) for b in range(5)] * 2)


def test_threads_are_used_again():
    def who():
        meeting, found = threading.Barrier(2, timeout=30), []
        share_out(lambda _: found.append(threading.get_ident()) or meeting.wait(), range(2), 2)
        return set(found) - {threading.get_ident()}

    assert who() == who() != set()


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_is_raised_when_what_has_begun_has_ended(threads):
    begun, ended = [], []

    def fails(n):
        begun.append(n)
        time.sleep(0.01)
        if n == 3:
            raise ValueError("item 3")
        ended.append(n)

    with pytest.raises(ValueError, match="item 3"):
        share_out(fails, range(1000), threads)
    assert len(begun) < 500  # others go on for as long as a busy machine lets this one wait
    assert sorted([*ended, 3]) == sorted(begun)
    share_out(ended.append, [-1], threads)  # nothing is left over


def test_an_interrupt_in_another_thread_reaches_the_caller_and_costs_no_thread():
    caller, both = threading.get_ident(), threading.Barrier(2, timeout=30)

    def interrupted(_):
        both.wait()
        if threading.get_ident() != caller:
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            share_out(interrupted, range(2), 2)


def test_an_interrupt_while_the_caller_waits_is_raised_when_others_have_ended():
    caller, both, left, ended = threading.get_ident(), threading.Barrier(2, timeout=30), threading.Event(), []

    def work(_):
        both.wait()
        if threading.get_ident() == caller:
            return
        for _ in range(2):
            while sys._current_frames()[caller].f_code.co_name != "wait":
                time.sleep(0.001)
            signal.pthread_kill(caller, signal.SIGINT)
            left.wait(0.2)
        ended.append(True)

    with pytest.raises(KeyboardInterrupt):
        share_out(work, range(2), 2)
    left.set()
    assert ended


def test_others_have_ended_when_the_system_has_no_more_threads(monkeypatch):
    begun, left, ended = threading.Event(), threading.Event(), []
    helped = threads._helped

    def work(_):
        begun.set()
        left.wait(0.2)
        ended.append(True)

    def scarce(some):
        if begun.wait(0):
            raise RuntimeError("can't start new thread")
        hired = helped(some)
        begun.wait(30)
        return hired

    monkeypatch.setattr(threads, "_helped", scarce)
    with pytest.raises(RuntimeError, match="new thread"):
        share_out(work, range(20), 3)
    left.set()
    assert ended


def test_a_forked_process_has_threads_of_its_own():
    share_out(lambda _: time.sleep(0.01), range(4), 2)
    child = os.fork()
    if child == 0:
        share_out(lambda _: None, range(4), 2)
        os._exit(7)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
