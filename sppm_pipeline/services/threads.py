"""Work done by threads: calls shared out, a bounded map, bands of layers, and a sequence one element ahead.

Maps keep only a few results at once, however long the sequence is. None changes what is computed: the results are
those of the plain loop for any number of threads.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")


def ordered_map(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int, ahead: int | None = None
) -> Iterator[Result]:
    """``map(function, items)`` by threads that run a bounded number of items ahead of the consumer of the results.

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


def share_out(function: Callable[[Item], object], items: Iterable[Item], threads: int) -> None:
    """Call a function for each item, in the caller's thread and others, which are kept for the next time.

    A slab of layers is shared out a dozen times. To start a thread and to wait for it takes a tenth of a millisecond,
    and the caller would look on meanwhile. Items are taken by one thread at a time, in their order; `threads` includes
    the caller's. The first error of a call, an interrupt among them, is raised when all that have begun have ended; no
    others begin.
    """
    waiting = list(items)
    others = min(threads, len(waiting)) - 1
    if others <= 0:
        for item in waiting:
            function(item)
        return
    waiting.reverse()
    errors: list[BaseException] = []

    def some() -> None:
        while not errors:
            try:
                item = waiting.pop()  # by one thread at a time
            except IndexError:
                return
            try:
                function(item)
            except BaseException as error:  # an interrupt as well: the caller has to know, and the thread lives on
                errors.append(error)

    ended: list[threading.Event] = []
    try:
        ended.extend(_helped(some) for _ in range(others))
        some()
    except BaseException as error:  # an interrupt may come between two calls, or the system has no thread to give
        errors.append(error)
    waiting.clear()
    for event in ended:
        while not event.is_set():
            try:
                event.wait()
            except BaseException as error:  # who goes on would share arrays with those that still write into them
                errors.append(error)
    if errors:
        raise errors[0]


_Task = tuple[Callable[[], None], threading.Event]
_idle: deque[SimpleQueue[_Task]] = deque()


def _helped(work: Callable[[], None]) -> threading.Event:
    """Have a thread do something, one that waits for work or a new one; says when it is done."""
    done = threading.Event()
    try:
        tasks = _idle.pop()
    except IndexError:  # busy threads are not waited for, so calls may be nested
        tasks = SimpleQueue()
        threading.Thread(target=_help, args=(tasks,), name="sppm-helper", daemon=True).start()
    tasks.put((work, done))
    return done


def _help(tasks: SimpleQueue[_Task]) -> None:
    while True:
        work, done = tasks.get()
        try:
            work()
        finally:
            del work  # which may hold arrays
            _idle.append(tasks)
            done.set()


if hasattr(os, "register_at_fork"):  # a forked process has none of the threads
    os.register_at_fork(after_in_child=_idle.clear)


def in_bands(function: Callable[[int, int], None], layers: int, threads: int) -> None:
    """Call ``function(start, stop)`` for bands that make up all layers, some for each thread as they differ in work."""
    if threads <= 1:
        function(0, layers)
        return
    height = max(1, -(-layers // (4 * threads)))
    starts = range(0, layers, height)
    share_out(lambda start: function(start, min(start + height, layers)), starts, threads)


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
