"""How much memory the machine has to spare, and a refusal in time for stages that need more."""

from __future__ import annotations

import sys
from pathlib import Path

from sppm_pipeline.errors import ResourceError

__all__ = ["available_memory", "require_memory"]

MEMINFO = Path("/proc/meminfo")
STATUS = Path("/proc/self/status")
CGROUP = Path("/sys/fs/cgroup")


def available_memory() -> int | None:
    """Bytes that this process can take without the system running out; None where the system does not tell.

    The least of what the machine has available, what its control group leaves, and what a limit of the address space
    leaves.
    """
    found = []
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


def require_memory(needed: float, what: str, hint: str) -> None:
    """Refuse what would not fit.

    Parameters
    ----------
    needed : float
        Bytes.
    what : str
        What needs them, as the beginning of a sentence.
    hint : str
        What to change.

    Raises
    ------
    ResourceError
        If less is available.
    """
    available = available_memory()
    if available is not None and needed > available:
        raise ResourceError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory; {available / 1e9:.3g} GB are available", hint=hint
        )


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
