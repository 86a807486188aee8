"""The short form of `kill_anywhere.py`: a few kills anywhere, and three runs on one cache."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("kill_anywhere.py")


@pytest.mark.skipif(sys.platform != "linux", reason="looks at processes through /proc")
def test_killed_runs_leave_nothing_and_end_as_if_undisturbed(tmp_path):
    spec = importlib.util.spec_from_file_location("kill_anywhere", SCRIPT)
    kill_anywhere = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(kill_anywhere)
    bench = kill_anywhere.Bench(tmp_path, seed=5)
    bench.measure(["cell"])
    bench.one_after_the_other(["cell"], 4)
    bench.at_the_same_time(["cell"], 3)
    assert bench.kills >= 5
    assert bench.findings == []
