"""An exception raised in a thread hits that thread, whatever it starts meanwhile."""

from __future__ import annotations

import threading
import time

from sppm_pipeline.process.interruption import raise_in


class Hit(BaseException):
    """What is raised."""


def test_the_right_thread_is_hit_while_it_starts_others():
    # a thread that is about to begin has the number of the one that starts it: without care, most rounds hit that one
    for delay in range(40):
        hit = []

        def work(hit=hit):
            try:
                for _ in range(400):
                    threading.Thread(target=lambda: None).start()
                time.sleep(0.01)
            except Hit:
                hit.append(True)

        thread = threading.Thread(target=work)
        thread.start()
        time.sleep(0.0005 * (delay % 7))
        raise_in(thread.ident, Hit)
        thread.join(10)
        assert hit
        assert not thread.is_alive()


def test_what_was_not_raised_yet_is_taken_back():
    begun, go = threading.Event(), threading.Event()
    seen = []

    def work():
        begun.set()
        go.wait()
        seen.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    begun.wait()
    time.sleep(0.05)  # it waits without a step of Python
    raise_in(thread.ident, Hit)
    raise_in(thread.ident, None)
    go.set()
    thread.join(10)
    assert seen == [True]
