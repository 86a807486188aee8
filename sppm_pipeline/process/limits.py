"""What the child may use: memory, threads, and the surroundings that are pinned for it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

LEAST_MEMORY = 1 << 30
"""Bytes that a child gets at least: an interpreter with a large library needs a good part of it."""

SHARE = 0.8
"""Share of the available memory that a child gets by default."""

_THREADS = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)


def default_memory() -> int:
    """Bytes that a child gets when nobody says how much: most of what the machine has left, at least 1 GiB."""
    return max(LEAST_MEMORY, int(SHARE * available_memory()))


def available_memory() -> int:
    """Bytes that this machine, or the control group we are in, can still hand out without swapping."""
    amounts = [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    amounts += [int(line.split()[1]) * 1024 for line in _lines("/proc/meminfo") if line.startswith("MemAvailable:")]
    for limit, used in (
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ):
        numbers = [lines[0].strip() for lines in (_lines(limit), _lines(used)) if lines]
        if len(numbers) == 2 and all(number.isdigit() for number in numbers):
            amounts.append(max(0, int(numbers[0]) - int(numbers[1])))
    return min(amounts)


def child_environment(inherited: Mapping[str, str], folder: Path, threads: int) -> dict[str, str]:
    """The environment of the child: that of the parent, with everything pinned that could change a result."""
    return {
        **inherited,
        **dict.fromkeys(_THREADS, str(threads)),
        "OMP_DYNAMIC": "false",
        "LC_ALL": "C.UTF-8",  # a decimal comma has spoilt many a reader of numbers
        "PYTHONUTF8": "1",
        "PYTHONHASHSEED": "0",
        "PYTHONUNBUFFERED": "1",  # what was printed before a crash is what its reader needs
        "TMPDIR": str(folder),
    }


def _lines(path: str) -> list[str]:
    try:
        return Path(path).read_text(encoding="ascii", errors="replace").splitlines()
    except OSError:
        return []
