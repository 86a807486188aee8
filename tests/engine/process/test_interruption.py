"""An exception raised in a thread hits that thread, whatever it starts meanwhile."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import psutil
import pytest

from sppm_pipeline.engine.process import interruption
from sppm_pipeline.engine.process.interruption import raise_in
from sppm_pipeline.engine.process.tree import signal_below


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


@pytest.mark.parametrize("recursive", [False, True])
def test_signals_reach_children_or_all_below(monkeypatch, recursive):
    class Below:
        """Process 1 has the child 2, and that the child 3."""

        def __init__(self, pid):
            self.pid = pid

        def children(self, recursive):
            return [Below(2), Below(3)] if recursive else [Below(2)]

        def send_signal(self, number):
            sent.append((self.pid, number))
            if self.pid == 2:
                raise psutil.NoSuchProcess(2)

    sent = []
    monkeypatch.setattr(psutil, "Process", Below)
    signal_below(1, signal.SIGTERM, recursive=recursive)
    assert sent == [(2, signal.SIGTERM), (3, signal.SIGTERM)][: 1 + recursive]


CALLBACK = """
import ctypes, os, signal, sys, threading, time
from sppm_pipeline.engine.process import interruption

@ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_int)
def callback(number):
    threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGTERM)).start()
    while not interruption.requested():
        time.sleep(0.01)
    for _ in range(10**6):  # the interrupt arrives in here, where it can't be raised
        pass
    return number

def work():
    callback(1)
    interruption.check()
    return 0

try:
    interruption.interruptibly(work, lambda: print("ended by force"))
except interruption.Interrupted as error:
    print("interrupted by", error.number)
"""


def test_an_interrupt_in_a_callback_of_native_code_prints_no_traceback():
    done = subprocess.run([sys.executable, "-c", CALLBACK], capture_output=True, text=True, timeout=60)
    assert done.stdout.strip() == "interrupted by 15"
    assert done.stderr == ""
