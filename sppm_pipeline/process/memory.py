"""How much memory a stage may take, and a refusal in time if it needs more: the one place where that is decided.

It is the least of what the machine has to spare and of what the user's limit for the whole process (``--memory``,
`Context.memory_limit`) leaves beside the memory that the process holds already.
"""

from __future__ import annotations

import sys
from pathlib import Path

from sppm_pipeline.errors import ResourceError

MEMINFO = Path("/proc/meminfo")
STATUS = Path("/proc/self/status")
CGROUP = Path("/sys/fs/cgroup")


def available_memory(limit: int | None) -> int | None:
    """Bytes that this process can take beside what it has; None where neither user nor system tells.

    The least of what the user's limit leaves, what the machine has available, what its control group leaves, and what a
    limit of the address space leaves.

    Parameters
    ----------
    limit : int or None
        Bytes that the whole process may take; `Context.memory_limit`.
    """
    found = [] if limit is None else [max(0, limit - (_entry(STATUS, "VmRSS:") or 0) * 1024)]
    if (available := _entry(MEMINFO, "MemAvailable:")) is not None:
        found.append(available * 1024)
    limit, used = (_number(CGROUP / name) for name in ("memory.max", "memory.current"))
    if limit is not None and used is not None:
        # what files were read or written keep in memory is given up when it is needed
        cached = _entry(CGROUP / "memory.stat", "inactive_file") or 0
        found.append(max(0, limit - used + cached))
    if sys.platform != "win32":
        import resource

        soft, _ = resource.getrlimit(resource.RLIMIT_AS)
        size = _entry(STATUS, "VmSize:")
        if soft != resource.RLIM_INFINITY and size is not None:
            found.append(max(0, soft - size * 1024))
    return min(found, default=None)


def require_memory(needed: float, what: str, hint: str, *, limit: int | None) -> None:
    """Refuse what would not fit.

    Parameters
    ----------
    needed : float
        Bytes.
    what : str
        What needs them, as the beginning of a sentence.
    hint : str
        What to change.
    limit : int or None
        Bytes that the whole process may take; `Context.memory_limit`.

    Raises
    ------
    ResourceError
        If less is available.
    """
    available = available_memory(limit)
    if available is not None and needed > available:
        of_limit = f" (--memory allows {limit / 1e9:.3g} GB in all)" if limit is not None else ""
        raise ResourceError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory; {available / 1e9:.3g} GB are available{of_limit}",
            hint=hint,
        )


def child_memory(limit: int | None) -> int | None:
    """Bytes for `run_native` to allow a child; None, which leaves the choice to it, if the user set no limit."""
    return None if limit is None else available_memory(limit)


def _entry(file: Path, key: str) -> int | None:
    try:
        for line in file.read_text(encoding="ascii", errors="replace").splitlines():
            if line.split()[:1] == [key]:
                return int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None


def _number(file: Path) -> int | None:
    try:
        return int(file.read_text(encoding="ascii"))
    except (OSError, ValueError):  # there is none, or it says "max"
        return None
