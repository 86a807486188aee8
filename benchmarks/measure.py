"""Measure whole processes: wall time, processor time and peak memory, as the operating system accounts them."""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

__all__ = ["Run", "median", "pipeline_command", "repeat_in_process", "run", "table"]


class Run(NamedTuple):
    """One finished process."""

    wall: float  # s
    cpu: float  # s, user and system
    peak: float  # MB resident


def pipeline_command(config: Path | str, out: Path | str) -> list[str]:
    """The command that runs a configuration quietly, with nothing kept from earlier runs: the work is measured."""
    return [sys.executable, "-m", "sppm_pipeline", "run", str(config), "-q", "--no-cache", "-o", str(out)]


def run(command: Sequence[str], *, limit_bytes: int | None = None) -> Run:
    """Run a command to its end, with at most `limit_bytes` of address space; `RuntimeError` if it fails."""

    def limit() -> None:
        import resource

        if limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_AS, (limit_bytes, limit_bytes))

    # installed programs have their bytecode; a setting of the developer must not be measured
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    with subprocess.Popen(
        list(command), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, preexec_fn=limit, env=environment
    ) as process:
        assert process.stderr is not None
        message = process.stderr.read().decode(errors="replace")
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - start
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)} ended with {process.returncode}:\n{message[-2000:]}")
    return Run(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def median(command: Sequence[str], runs: int = 5, **options: int | None) -> Run:
    """The median of several runs after one that warms the caches, figure by figure."""
    run(command, **options)
    done = [run(command, **options) for _ in range(runs)]
    return Run(*(statistics.median(values) for values in zip(*done, strict=True)))


def repeat_in_process(function: Callable[[], object], runs: int = 7) -> tuple[float, float]:
    """Median wall and processor seconds of a call inside this process, after one that warms it up."""
    function()
    walls, cpus = [], []
    for _ in range(runs):
        wall, cpu = time.perf_counter(), time.process_time()
        function()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return statistics.median(walls), statistics.median(cpus)


def between_marks(page: Path, mark: str, text: str) -> None:
    """Put text between the two lines of a page that are a mark."""
    line = mark.rstrip("\n")
    before, _, after = page.read_text(encoding="utf-8").split(line)
    ended = text.rstrip("\n")
    page.write_text(f"{before}{line}\n{ended}\n{line}{after}", encoding="utf-8")


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows in columns."""
    cells = [list(header)] + [[f"{v:.3g}" if isinstance(v, float) else str(v) for v in row] for row in rows]
    widths = [max(len(row[i]) for row in cells) for i in range(len(header))]
    print(f"\n{title}")
    for row in cells:
        print("  ".join(value.rjust(width) for value, width in zip(row, widths, strict=True)))
    sys.stdout.flush()
