"""Work done by threads, its results in order: a bounded map, and a sequence that is computed one element ahead.

Both keep only a few results at once, however long the sequence is. Neither changes what is computed: the results are
those of the plain loop for any number of threads.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int, ahead: int | None = None
) -> Iterator[Result]:
    """``map(function, items)`` by threads that run a bounded number of items ahead of whoever takes the results.

    Items are taken in the caller's thread, and only as many as are needed. Leaving the iterator early cancels what has
    not begun.

    Parameters
    ----------
    function : callable
        What is applied to each item; it runs in several threads at once.
    items : iterable
        Arguments.
    threads : int
        Number of threads; one maps in the caller's own.
    ahead : int, optional
        Maximum number of results kept or computed beside the one in use; twice the number of threads if omitted.

    Yields
    ------
    Result
        In the order of the items.
    """
    if threads <= 1:
        yield from map(function, items)
        return
    bound = 2 * threads if ahead is None else ahead
    pool = ThreadPoolExecutor(threads)
    try:
        waiting: deque[Future[Result]] = deque()
        for item in items:
            waiting.append(pool.submit(function, item))
            if len(waiting) > bound:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(cancel_futures=True)


def computed_ahead(items: Iterator[Item], threads: int) -> Iterator[Item]:
    """The same items; with more than one thread the next one is computed while the last one is in use."""
    if threads <= 1:
        yield from items
        return
    end: Any = object()
    with ThreadPoolExecutor(1) as worker:
        coming = worker.submit(next, items, end)
        while (item := coming.result()) is not end:
            coming = worker.submit(next, items, end)
            yield item
