"""Threads share one heap where that was asked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

from sppm_pipeline.engine.process.resident import share_one_heap

PROGRAM = """
import ctypes, sys, threading
from sppm_pipeline.engine.process.resident import share_one_heap
if sys.argv[1] == "shared":
    assert share_one_heap()
together = threading.Barrier(4)
def work():
    kept = [bytearray(5000) for _ in range(200)]
    together.wait()
threads = [threading.Thread(target=work) for _ in range(4)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
ctypes.CDLL(None).malloc_stats()
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux is asked")
def test_threads_share_one_heap():
    def heaps(how):
        command = [sys.executable, "-c", PROGRAM, how]
        return subprocess.run(command, check=True, capture_output=True, text=True).stderr.count("Arena ")

    if heaps("own") < 2:
        pytest.skip("this C library gives threads no heaps of their own")
    assert heaps("shared") == 1


def test_elsewhere_nothing_is_asked(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    assert not share_one_heap()
