"""Memory and disk that a run may take, what is left of them, and which errors say that a resource is exhausted.

One answer for everybody: the refusal of a run by its estimate, stages that plan or check their memory, and the limit of
native children all start from `allowed_memory`, which is the minimum of

* the user's limit (``--memory``),
* the address space that the process is allowed (``ulimit -v``),
* what the control groups of its container leave (`control_groups`), and
* what the machine can hand out without swapping.

The last three are given as what this process holds already plus what it can get beside that, so that all four limit
the same quantity: the memory resident in this process.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from sppm_pipeline.errors import ResourceError

MEMORY = "SPPM_MEMORY"
"""Environment variable with the bytes that a run may take; set by ``--memory``, inherited by worker processes."""

DEFAULT_PLAN = 2 * 2**30
"""Bytes that a stage which can choose plans with at most, if the user set no limit."""

MINIMUM_CHILD = 400 * 2**20
"""Bytes that a native child may take at least: an interpreter with NumPy and a large library, and a small mesh."""

_UNLIMITED = 2**60
"""Limits of control groups from here on mean that there is none: version 1 writes the largest number of pages."""

EXHAUSTED = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOMEM,
             errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.EIO, errno.ENAMETOOLONG, errno.EMLINK,
             errno.ELOOP)  # fmt: skip
"""Errors of the system that mean: a resource or a permission of this machine is missing."""


class Allowance(NamedTuple):
    """A limit of the `bytes` resident in this process, what it holds now included; `source` begins a sentence."""

    bytes: int
    source: str


def requested_memory() -> int | None:
    """Bytes that the user allows a run to take; None without a limit."""
    text = os.environ.get(MEMORY, "")
    return int(text) if text.isascii() and text.isdecimal() and int(text) > 0 else None


def allowed_memory(limit: int | None = None) -> Allowance:
    """The memory that this process may hold; `limit` is the user's in bytes, that of ``--memory`` if omitted."""
    resident, reserved = held_memory()
    limit = requested_memory() if limit is None else limit
    # what this process holds now counts as allowed: only what is added can be refused
    found = [Allowance(resident + _machine(), "the free memory of this machine")]
    found += [Allowance(resident + left, "the memory left in this container") for left in control_groups()]
    if (space := _address_space()) is not None:
        # pages that are reserved but not used are no memory, yet they take of the address space
        found.append(Allowance(resident + max(0, space - reserved), "the address space left to this process"))
    if limit is not None:
        found.append(Allowance(limit, "the limit given by --memory"))
    return min(found)


def available_memory(limit: int | None = None) -> int:
    """Bytes that this process can take beside what it holds; `limit` as for `allowed_memory`."""
    return max(0, allowed_memory(limit).bytes - held_memory()[0])


def child_memory(limit: int | None = None) -> int:
    """Bytes that a native child may take: all that is available, at least `MINIMUM_CHILD`."""
    return max(MINIMUM_CHILD, available_memory(limit))


@functools.lru_cache(maxsize=1)
def _plan(requested: int | None) -> int:
    return requested or min(DEFAULT_PLAN, allowed_memory().bytes)


def planning_memory() -> int:
    """Bytes that a stage which can choose plans with: the user's limit, else 2 GiB or what is there.

    Measured once in a process, as each stage of each recipe asks.
    """
    return _plan(requested_memory())


def require_memory(needed: float, what: str, hint: str, *, limit: int | None) -> None:
    """Raise `ResourceError` if so many bytes are not available; `limit` is for the whole process.

    `what` needs them, as the beginning of a sentence; `hint` says what to change.
    """
    available = available_memory(limit)
    if needed > available:
        of_limit = f" (--memory allows {limit / 1e9:.3g} GB in all)" if limit is not None else ""
        raise ResourceError(
            f"{what} needs about {needed / 1e9:.3g} GB of memory; {available / 1e9:.3g} GB are available{of_limit}",
            hint=hint,
        )


def held_memory() -> tuple[int, int]:
    """Bytes resident in this process, and its address space; zeros where the system does not say."""
    # as psutil reads it on Linux, whose import takes longer than all else here
    with contextlib.suppress(OSError, ValueError, IndexError):
        pages = (_proc() / "self/statm").read_bytes().split()
        return int(pages[1]) * os.sysconf("SC_PAGE_SIZE"), int(pages[0]) * os.sysconf("SC_PAGE_SIZE")
    import psutil

    try:
        info = psutil.Process().memory_info()
    except (psutil.Error, OSError):  # no /proc is mounted
        return 0, 0
    return int(info.rss), int(info.vms)


def _machine() -> int:
    """Bytes that the machine can hand out without swapping; all it has, where the system does not say more."""
    with contextlib.suppress(OSError):
        found = re.search(rb"^MemAvailable:\s*(\d+) kB", (_proc() / "meminfo").read_bytes(), re.MULTILINE)
        if found:
            return int(found[1]) * 1024
    import psutil

    try:
        return int(psutil.virtual_memory().available)
    except OSError:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def _address_space() -> int | None:
    if sys.platform == "win32":
        return None
    import resource

    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if soft == resource.RLIM_INFINITY else soft


class _Files(NamedTuple):
    """Names of the files of a memory controller.

    `cached` are the keys in ``memory.stat`` of file contents that are given up when memory is needed, the preferred
    first.
    """

    limits: tuple[str, ...]
    used: str
    cached: tuple[str, ...]


_VERSION_1 = _Files(
    ("memory.limit_in_bytes",), "memory.usage_in_bytes", ("total_inactive_file", "inactive_file")
)  # the first counts those of the groups below as well, as the usage does
_VERSION_2 = _Files(("memory.max", "memory.high"), "memory.current", ("inactive_file",))


def control_groups() -> Iterator[int]:
    """Bytes that each control group with a limit leaves, of the groups that this process is in (cgroups(7)).

    Both versions, as both may be mounted; the own group and all above it in sight, as each limits the sum of those
    below.
    """
    for files, folder, top in _mounted_groups():
        for group in (folder, *folder.parents):
            limits = [n for name in files.limits if (n := _number(group / name)) is not None and n < _UNLIMITED]
            used = _number(group / files.used)
            if limits and used is not None:
                yield max(0, min(limits) - used + _cached(group, files))
            if group == top:
                break


def _mounted_groups() -> Iterator[tuple[_Files, Path, Path]]:
    """For each version with a memory controller: its files, the folder of our group, and the top of what is mounted.

    ``/proc/self/cgroup`` names the group within the hierarchy, ``/proc/self/mountinfo`` where the hierarchy, or in a
    container only the part of it below some root, is mounted (proc(5)).
    """
    proc = _proc() / "self"
    groups: dict[_Files, str] = {}
    for line in _lines(proc / "cgroup"):
        number, _, rest = line.partition(":")
        controllers, _, path = rest.partition(":")
        if number == "0" and not controllers:
            groups[_VERSION_2] = path
        elif "memory" in controllers.split(","):
            groups[_VERSION_1] = path
    for line in _lines(proc / "mountinfo"):
        mount, _, system = line.partition(" - ")
        words, kind = mount.split(" "), system.split(" ")
        if len(words) < 5 or len(kind) < 3:
            continue
        if kind[0] == "cgroup2":
            files = _VERSION_2
        elif kind[0] == "cgroup" and "memory" in kind[2].split(","):
            files = _VERSION_1
        else:
            continue
        if files in groups:  # the first mount is enough
            path = groups.pop(files)
            # blanks are written as octal numbers
            root, top = (re.sub(r"\\([0-7]{3})", lambda found: chr(int(found[1], 8)), word) for word in words[3:5])
            yield files, _folder(path, root, Path(top)), Path(top)


def _proc() -> Path:
    """Mount point of procfs, `psutil.PROCFS_PATH` if that is set."""
    return Path(getattr(sys.modules.get("psutil"), "PROCFS_PATH", "/proc"))


def _folder(path: str, root: str, top: Path) -> Path:
    """Folder of a group; the top of what is mounted if the group is outside of it."""
    inner = os.path.relpath(path, root)
    return top if inner == "." or inner.startswith("..") else top / inner


def _cached(group: Path, files: _Files) -> int:
    entries = dict(line.split(" ", 1) for line in _lines(group / "memory.stat") if " " in line)
    return next((int(entries[key]) for key in files.cached if entries.get(key, "").isdecimal()), 0)


def _number(file: Path) -> int | None:
    """The number in a file; None if there is no such file, or it says ``max``."""
    text = "".join(_lines(file)).strip()
    return int(text) if text.isascii() and text.isdecimal() else None


def _lines(file: Path) -> list[str]:
    try:
        return file.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []


def free_disk(folder: Path) -> int | None:
    """Bytes free for this user where `folder` is or will be; None where the system does not say."""
    place = Path(os.path.abspath(folder))
    while not place.exists() and place != place.parent:
        place = place.parent
    try:
        return shutil.disk_usage(place).free
    except OSError:
        return None


def format_bytes(count: float) -> str:
    """``3.4 GB``; powers of 1000, as sizes of files are shown."""
    for unit in ("bytes", "kB", "MB", "GB"):
        if abs(count) < 999.5:
            return f"{count:.3g} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def exhausted_resource(error: BaseException) -> str | None:
    """Which resource an error says is exhausted or forbidden, as a message; None if it is another kind of error.

    A library that can't be loaded for lack of descriptors, memory or a permission raises `ImportError` with the
    system's words somewhere in it; a folder that can't be read makes its modules seem not to exist.
    """
    if isinstance(error, MemoryError):
        return "not enough memory"
    if isinstance(error, OSError):
        place = f": {error.filename!r}" if error.filename is not None else ""
        return f"{error.strerror or error}{place}" if error.errno in EXHAUSTED else None
    if isinstance(error, RuntimeError) and str(error) == "can't start new thread":
        return "no more threads can be started"
    if not isinstance(error, ImportError):
        return None
    name = f"can't load {error.name!r}" if error.name else "a library can't be loaded"
    cause: BaseException | None = error
    while cause is not None:
        if cause is not error and (found := exhausted_resource(cause)) is not None:
            return f"{name}: {found}"
        words = [os.strerror(number) for number in EXHAUSTED if os.strerror(number) in str(cause)]
        if words or "failed to map segment" in str(cause):
            return f"{name}: {words[0] if words else os.strerror(errno.ENOMEM)}"
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, ModuleNotFoundError) and (error.name or "").split(".")[0] in sys.stdlib_module_names:
        return f"{name}, a part of Python: its installation is incomplete or may not be read"
    return None
