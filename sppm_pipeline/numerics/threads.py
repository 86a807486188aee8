"""Work done by threads, its results in order: a bounded map, bands of layers, and a sequence one element ahead.

All keep only a few results at once, however long the sequence is. None changes what is computed: the results are
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


def in_bands(function: Callable[[int, int], None], layers: int, threads: int) -> None:
    """Call ``function(start, stop)`` for bands that make up all layers, some for each thread as they differ in work."""
    if threads <= 1:
        function(0, layers)
        return
    height = max(1, -(-layers // (4 * threads)))
    starts = range(0, layers, height)
    for _ in ordered_map(lambda start: function(start, min(start + height, layers)), starts, threads):
        pass


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
