"""A row of a sweep that is stuck in compiled code or stopped is ended by its guard, named, and not run again."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
import time

import pytest

from sppm_pipeline.engine.process import activity, guard

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are ended by force on POSIX only")

PLUGIN = '''
import ctypes, os, signal, time
from dataclasses import dataclass
from typing import ClassVar
from sppm_pipeline import Artifact, Context, Stage, option
from sppm_pipeline.engine.process import containment

containment.GRACE, containment.LAST = 0.5, 0.5

@dataclass(frozen=True)
class Number(Artifact):
    """A number."""
    value: int
    def summary(self):
        return {"value": self.value}

@dataclass(frozen=True, kw_only=True)
class Stuck(Stage):
    """Get stuck in one row."""
    name: ClassVar[str] = "sample.stuck"
    row: int = option(help="number of the row")
    def run(self, context: Context) -> Number:
        if self.row == 1:
            HOW
        return Number(self.row)
'''

HOWS = {
    "keeps the lock": "ctypes.PyDLL(None).usleep(590_000_000)",
    "releases the lock": "ctypes.CDLL(None).usleep(590_000_000)",
    "stopped": "os.kill(os.getpid(), signal.SIGSTOP)",
}

SWEEP = """sppm: 1
params: {n: 0}
plugins: [stuck.py]
pipeline: [{stage: sample.stuck, id: trap, row: "${n}"}]
sweep: {n: [0, 1, 2, 3]}
"""


@pytest.mark.parametrize(("how", "jobs"), [("keeps the lock", 1), ("releases the lock", 2), ("stopped", 2)])
def test_a_stuck_row_is_ended_and_named(tmp_path, how, jobs):
    (tmp_path / "stuck.py").write_text(PLUGIN.replace("HOW", HOWS[how]))
    (tmp_path / "stuck.yaml").write_text(SWEEP)
    command = [sys.executable, "-m", "sppm_pipeline", "run", "stuck.yaml", "-o", "out", "-q", "--no-cache"]
    done = subprocess.run(
        [*command, "-j", str(jobs), "--stage-time", "1.5"], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 4, done.stderr
    assert "Traceback" not in done.stderr
    with (tmp_path / "out/sweep.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [bool(row["error"]) for row in rows] == [False, True, False, False]
    assert [row["trap.value"] for row in rows] == ["0", "", "2", "3"]
    assert "stuck.py: the stage 'sample.stuck'" in rows[1]["error"]
    assert "longer than the 1.5 seconds" in rows[1]["error"]
    record = json.loads((tmp_path / "out/run.json").read_text())
    assert record["runs"][1]["attempts"] == 1
    assert record["runs"][1]["error"]["stage"] == "trap"
    alone = json.loads((tmp_path / "out/runs/0001/run.json").read_text())
    assert alone["status"] == "failed"
    left = sorted(file.name for file in (tmp_path / "out").iterdir())
    assert left == ["SHA256SUMS", "run.json", "runs", "sweep.csv", "sweep.csv-metadata.json", "sweep.json"]


def test_a_guard_ends_with_its_worker_and_leaves_one_in_time_alone(tmp_path):
    program = f"""
from pathlib import Path
from sppm_pipeline.engine.process import activity, guard
import time
for name in "ab":
    notes = Path({str(tmp_path)!r}, name)
    activity.share(notes)
    guard.guard(notes)
    with activity.doing(activity.Activity("a stage", True), 60.0):
        time.sleep(0.6)
print(guard._guard.pid, flush=True)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True)
    assert activity.overdue(tmp_path / "a") is activity.overdue(tmp_path / "b") is None
    until = time.monotonic() + 10
    while os.path.exists(f"/proc/{done.stdout.strip()}") and time.monotonic() < until:
        time.sleep(0.05)
    assert not os.path.exists(f"/proc/{done.stdout.strip()}")
    assert guard._guard is None
