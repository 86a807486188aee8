"""Installed distributions, their versions and requirements, from the names of their folders.

`importlib.metadata` parses a file for each question, which takes as long as everything else in a run whose results
are all kept.
"""

from __future__ import annotations

import functools
import os
import re
import sys

_FOLDER = re.compile(r"(.+?)-([^-]+)(-py[\d.]+)?\.(dist|egg)-info")
_REQUIRED = re.compile(r"^Requires-Dist: ([\w.-]+)(.*)$", re.MULTILINE)
_NOT_IN_USE = re.compile(r"extra\s*==\s*['\"](test|dev|docs)['\"]")


def installed_version(name: str) -> str | None:
    """The version of a distribution; None if it is not installed."""
    found = _installed().get(_normal(name))
    return found[0] if found else None


def requirements_of(name: str) -> list[str]:
    """Names of the distributions that one requires, for itself or for an extra other than those of its developers."""
    found = _installed().get(_normal(name))
    if found is None:
        return []
    try:
        with open(os.path.join(found[1], "METADATA"), encoding="utf-8") as file:
            head = file.read().split("\n\n")[0]
    except OSError:
        return []
    return sorted({_normal(wanted) for wanted, how in _REQUIRED.findall(head) if not _NOT_IN_USE.search(how)})


@functools.cache
def _installed() -> dict[str, tuple[str, str]]:
    """Version and folder of each distribution; what comes first on the path is what is imported."""
    found: dict[str, tuple[str, str]] = {}
    for place in sys.path:
        try:
            names = sorted(os.listdir(place or "."))
        except OSError:
            continue
        for name in names:
            if name.endswith("-info") and (match := _FOLDER.fullmatch(name)):
                found.setdefault(_normal(match[1]), (match[2], os.path.join(place, name)))
    return found


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()
