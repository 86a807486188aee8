"""What the machine has: memory, space on a disk; and which errors say that it lacks something."""

from __future__ import annotations

import errno
import os
import shutil
import sys
from pathlib import Path

LACKING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOMEM, errno.EMFILE,
           errno.ENFILE, errno.EAGAIN, errno.EIO, errno.ENAMETOOLONG, errno.EMLINK, errno.ELOOP)  # fmt: skip
"""Errors of the system that mean: something of this machine is missing."""

MEMORY = "SPPM_MEMORY"
"""Environment variable with the bytes that a run may take; set by ``--memory``."""

DEFAULT_BUDGET = 2 * 2**30
"""Bytes that a stage which can choose plans with, if nobody set a limit; results must not depend on it."""


def memory_budget() -> int:
    """Bytes that stages may plan with."""
    return wished_memory() or DEFAULT_BUDGET


def allowed_memory() -> tuple[int | None, str]:
    """Bytes that this process may take at most, and what limits them; None if nobody can tell.

    The smallest of: the user's wish, the address space that the process is allowed, the memory that its control
    group is allowed, and the memory of the machine that is free or can be freed.
    """
    limits: list[tuple[int, str]] = []
    if wished := wished_memory():
        limits.append((wished, "the limit given by --memory"))
    limits += [(space, "the address space this process is allowed") for space in _address_space()]
    limits += [(left, "the memory of this container") for left in _control_group()]
    limits += [(free, "the free memory of this machine") for free in _free_memory()]
    return min(limits, default=(None, ""), key=lambda limit: limit[0])


def wished_memory() -> int | None:
    """Bytes that the user allows a run to take; None if nothing was said."""
    text = os.environ.get(MEMORY, "")
    return int(text) if text.isascii() and text.isdecimal() and int(text) > 0 else None


def _address_space() -> list[int]:
    try:
        import resource
    except ImportError:  # Windows
        return []
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return [] if soft == resource.RLIM_INFINITY else [soft]


def _control_group() -> list[int]:
    found = []
    for name in ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"):
        try:
            text = Path(name).read_text(encoding="utf-8").strip()
        except (OSError, UnicodeDecodeError):
            continue
        if text.isdecimal() and int(text) < 2**60:
            found.append(int(text))
    return found


def _free_memory() -> list[int]:
    try:
        with Path("/proc/meminfo").open(encoding="utf-8") as file:
            for line in file:
                if line.startswith("MemAvailable:"):
                    return [int(line.split()[1]) * 1024]
    except (OSError, ValueError):
        pass
    try:
        return [os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")]
    except (AttributeError, OSError, ValueError):
        return []


def free_disk(folder: Path) -> int | None:
    """Bytes free for this user where `folder` is or will be; None if nobody can tell."""
    place = Path(os.path.abspath(folder))
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return shutil.disk_usage(place).free
    except OSError:
        return None


def lack(error: BaseException) -> str | None:
    """What of this machine an error says is missing; None if it says something else.

    A library that can't be loaded for want of descriptors, memory or a permission raises `ImportError` with the
    system's words somewhere in it; a folder that can't be read makes its modules seem not to exist.
    """
    if isinstance(error, MemoryError):
        return "not enough memory"
    if isinstance(error, OSError):
        place = f": {error.filename!r}" if error.filename is not None else ""
        return f"{error.strerror or error}{place}" if error.errno in LACKING else None
    if isinstance(error, RuntimeError) and str(error) == "can't start new thread":
        return "no more threads can be started"
    if not isinstance(error, ImportError):
        return None
    name = f"can't load {error.name!r}" if error.name else "a library can't be loaded"
    cause: BaseException | None = error
    while cause is not None:
        if cause is not error and (found := lack(cause)) is not None:
            return f"{name}: {found}"
        words = [os.strerror(number) for number in LACKING if os.strerror(number) in str(cause)]
        if words or "failed to map segment" in str(cause):
            return f"{name}: {words[0] if words else os.strerror(errno.ENOMEM)}"
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in sys.stdlib_module_names:
        return f"{name}, a part of Python: its installation is incomplete or may not be read"
    return None


def words_for_bytes(count: float) -> str:
    """``3.4 GB``; powers of 1000, as sizes of files are shown."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if abs(count) < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"
