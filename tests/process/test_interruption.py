"""An exception raised in a thread hits that thread, whatever it starts meanwhile."""

from __future__ import annotations

import sys
import threading
import time

from sppm_pipeline.process import interruption
from sppm_pipeline.process.interruption import raise_in


class Hit(BaseException):
    """What is raised."""


def test_the_right_thread_is_hit_while_it_starts_others():
    # a thread that is about to begin has the number of the one that starts it: without care, most rounds hit that one
    for delay in range(40):
        hit, over = [], threading.Event()

        def work(hit=hit, over=over):
            try:
                while not over.is_set():
                    threading.Thread(target=lambda: None).start()
            except Hit:
                hit.append(True)

        thread = threading.Thread(target=work)
        thread.start()
        time.sleep(0.0005 * (delay % 7))
        raise_in(thread.ident, Hit)
        thread.join(60)
        over.set()
        thread.join()
        assert hit


def test_what_was_not_raised_yet_is_taken_back(monkeypatch):
    begun, go = threading.Event(), threading.Event()
    seen = []

    def work():
        begun.set()
        go.wait()
        seen.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    begun.wait()
    monkeypatch.setattr(interruption, "BEGINNING", 0)  # nor is any other test's thread waited for
    switching = sys.getswitchinterval()
    sys.setswitchinterval(60)  # it takes no step of Python until both are done, wherever it is
    try:
        raise_in(thread.ident, Hit)
        raise_in(thread.ident, None)
    finally:
        sys.setswitchinterval(switching)
    go.set()
    thread.join()
    assert seen == [True]
