"""The installed distributions and their entry points, read from their folders.

`importlib.metadata` gives the same and more, but takes as long as the rest of finding the plugins together, most of it
for the mail parser that it imports. It is asked where a distribution may lie elsewhere than in a folder of the path.
"""

from __future__ import annotations

import functools
import importlib
import os
import re
import sys
from collections.abc import Iterator
from importlib.machinery import PathFinder
from typing import Any, NamedTuple

_FOLDER = re.compile(r"(.+?)(?:-([^-]+)(-py[\d.]+(?:-.+)?)?)?\.(dist|egg)-info")
_TARGET = re.compile(r"\s*([\w.]+)\s*(?::\s*([\w.]+)\s*)?(\[.*\])?\s*")


class Distribution(NamedTuple):
    """An installed distribution: its name, its version, and the folder (or the one file) of its metadata.

    A folder may not name the version, as where sources lie on the path; `version_of` then reads it.
    """

    name: str
    version: str
    folder: str


class EntryPoint(NamedTuple):
    """An entry point of a distribution: a name, and ``module`` or ``module:attribute``."""

    name: str
    value: str
    dist: Distribution

    def load(self) -> Any:
        """Import it; `ImportError` or `AttributeError` if it is not there."""
        found = _TARGET.fullmatch(self.value)
        if found is None:
            raise ImportError(f"{self.value!r} is neither `module` nor `module:attribute`")
        return functools.reduce(getattr, filter(None, (found[2] or "").split(".")), importlib.import_module(found[1]))


def normal(name: str) -> str:
    """A normalized name: ``-``, ``_`` and ``.`` are equal in names of distributions, and so are upper and lower
    case."""
    return re.sub(r"[-_.]+", "-", name).lower()


def distributions() -> dict[str, Distribution]:
    """Distributions by `normal` name; what comes first on the path is what is imported."""
    found: dict[str, Distribution] = {}
    for place in sys.path:
        try:
            names = sorted(os.listdir(place or "."))
        except OSError:
            continue
        for name in names:
            if name.endswith("-info") and (match := _FOLDER.fullmatch(name)):
                found.setdefault(normal(match[1]), Distribution(match[1], match[2] or "", os.path.join(place, name)))
    return found


def entry_points(group: str) -> list[Any]:
    """Entry points of a group, with attributes ``name``, ``value``, ``dist`` and ``load``."""
    if any(os.path.isfile(place) for place in sys.path) or any(
        hasattr(finder, "find_distributions") and finder is not PathFinder for finder in sys.meta_path
    ):
        from importlib.metadata import entry_points

        return list(entry_points(group=group))
    found: list[EntryPoint] = []
    for distribution in distributions().values():
        try:
            with open(os.path.join(distribution.folder, "entry_points.txt"), encoding="utf-8") as file:
                text = file.read()
        except OSError:  # most have none
            continue
        if f"[{group}]" in text:
            named = _named(distribution)
            found += [EntryPoint(name, value, named) for name, value in _pairs(text, group)]
    return found


def _pairs(text: str, group: str) -> Iterator[tuple[str, str]]:
    """Name and value of each line of a section."""
    section = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1]
        elif section == group and "=" in line and not line.startswith("#"):
            name, _, value = line.partition("=")
            yield name.strip(), value.strip()


def version_of(distribution: Distribution) -> str:
    """The version, from the metadata where the folder does not name it."""
    return distribution.version or _named(distribution).version


def metadata_of(distribution: Distribution) -> str:
    """The fields of the metadata, without the description; empty if they can't be read."""
    folder = distribution.folder
    for file in (os.path.join(folder, "METADATA"), os.path.join(folder, "PKG-INFO"), folder):
        try:
            with open(file, encoding="utf-8", errors="replace") as opened:
                return opened.read().partition("\n\n")[0]
        except OSError:
            continue
    return ""


def _named(distribution: Distribution) -> Distribution:
    """A distribution under the name and version that its metadata give; the folder's may be written otherwise."""
    lines = metadata_of(distribution).splitlines()
    about = {key.lower(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return distribution._replace(
        name=about.get("name") or distribution.name, version=about.get("version", distribution.version)
    )
