"""Maps by threads: the order of the items, a bounded number of results, nothing begun after the caller has left."""

import threading
import time

import pytest

from sppm_pipeline.numerics.threads import computed_ahead, ordered_map


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
