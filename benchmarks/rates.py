"""Compare what `sppm estimate` says with what runs take, and correct the table of rates that comes with the program.

    python -m benchmarks.rates [NAME ...] [--write]

Runs configurations and examples at a low resolution (those of ``benchmarks/digests.py``), each twice in a process of
its own on one thread, so that the second has its kernels on the disk, and prints memory and processor time of the
second beside their estimates. With ``--write``, of each stage that ran

* seconds are scaled by the geometric mean of what was measured over what was estimated, if that is beyond a factor 1.5,
* memory gets a constant part by which no run was estimated too low, or is scaled down if all were beyond a factor 1.3,
* a stage without an entry gets one, of constants; units in which it grows are left to the author of the stage.

Times want a machine without other work.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.digests import SMALL, command, small
from sppm_pipeline.engine.config.parameters import Overrides
from sppm_pipeline.engine.plan.checking import checked
from sppm_pipeline.engine.plan.estimate import TABLE, PlanEstimate, table
from sppm_pipeline.engine.plan.session import RunRequest, open_session


class Measured(NamedTuple):
    """A stage of a run: seconds and bytes as estimated and as they were; 0 where nothing was estimated."""

    stage: str
    estimated: tuple[float, float]
    taken: tuple[float, float]


def measure(name: str, folder: Path) -> tuple[list[PlanEstimate], tuple[float, float], list[Measured]]:
    """The estimates of a configuration, its processor time and largest memory in bytes, and its stages."""
    file, wanted = small(name, folder)
    overrides = Overrides(wanted.params, tuple(" ".join(option.split()) for option in wanted.options))
    estimates = checked(open_session(RunRequest(str(file), overrides=overrides))).estimates
    words = [sys.executable, "-m", "sppm_pipeline", *command(name, folder), "--threads", "1"]
    for _ in range(2):
        child = subprocess.Popen(words, stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if status:
            raise SystemExit(f"{name}: the run has failed")
    records = sorted((folder / "run").glob("runs/*/run.json")) or [folder / "run" / "run.json"]
    stages = list(_stages(estimates, [json.loads(record.read_text()) for record in records]))
    return estimates, (used.ru_utime + used.ru_stime, 1024.0 * used.ru_maxrss), stages


def _stages(estimates: list[PlanEstimate], records: list[dict[str, Any]]) -> Iterator[Measured]:
    for estimate, record in zip(estimates, records, strict=False):
        known = {stage.step.id: stage for stage in estimate.stages}
        for entry in record["stages"]:
            found = known[entry["id"]]
            said = (found.cost.seconds, found.resident) if found.cost is not None else (0.0, 0.0)
            yield Measured(
                found.step.stage.rated_as, said, (entry["seconds"], 1e6 * (entry.get("peak_memory_mb") or 0.0))
            )


def corrected(entry: dict[str, dict[str, float]], found: list[Measured]) -> dict[str, dict[str, float]]:
    """An entry of the table by what was measured."""
    seconds, memory = dict(entry["seconds"]), dict(entry["memory"])
    long = [one for one in found if one.taken[0] > 0.05 and one.estimated[0] > 0]
    if long:
        factor = math.exp(sum(math.log(one.taken[0] / one.estimated[0]) for one in long) / len(long))
        if not 1 / 1.5 < factor < 1.5:
            seconds = {unit: float(f"{factor * rate:.3g}") for unit, rate in seconds.items()}
    lacking = max(one.taken[1] - one.estimated[1] for one in found)
    if lacking > 0:
        memory["1"] = float(f"{memory.get('1', 0.0) + lacking:.3g}")
    elif all(one.estimated[1] > 1.3 * one.taken[1] > 0 for one in found):
        memory = {unit: float(f"{rate / 1.3:.3g}") for unit, rate in memory.items()}
    return {**entry, "seconds": seconds, "memory": memory}


def main(words: list[str]) -> None:
    """Measure, print, and correct the table if that is asked for."""
    names = [word for word in words if not word.startswith("-")] or list(SMALL)
    by_stage: dict[str, list[Measured]] = defaultdict(list)
    print(f"{'':24s} {'MB':>6s} {'estimate':>9s}      {'CPU s':>7s} {'estimate':>9s}")
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            estimates, (seconds, memory), stages = measure(name, Path(folder))
        said = max(one.memory for one in estimates)
        start = estimates[0].start
        total = start + sum(one.seconds - start for one in estimates)
        marks = " at least" if any(one.unknown for one in estimates) else ""
        print(f"{name:24s} {memory / 1e6:6.0f} {said / 1e6:9.0f} {said / memory:4.2f} {seconds:7.1f} {total:9.1f} "
              f"{total / seconds:4.2f}{marks}", flush=True)  # fmt: skip
        for stage in stages:
            by_stage[stage.stage].append(stage)
    if "--write" in words:
        rates = {name: {column: dict(units) for column, units in entry.items()} for name, entry in table().items()}
        empty: dict[str, dict[str, float]] = {"seconds": {}, "memory": {}, "kept": {}, "disk": {}}
        for name, found in by_stage.items():
            rates[name] = corrected(rates.get(name, empty), found)
        lines = [f"{json.dumps(name)}: {json.dumps(rates[name])}" for name in sorted(rates)]
        TABLE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
