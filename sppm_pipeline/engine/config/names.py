"""Names of outputs: inside the run directory, and possible on every file system that a run may be copied to."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable
from pathlib import PurePosixPath

from sppm_pipeline.engine.config.document import unprintable
from sppm_pipeline.engine.config.problems import Problems, shown
from sppm_pipeline.errors import ConfigError, Position

STAGING = ".staging-"
REPORT = "report.html"
"""File that `sppm report` writes into a run directory; no part of the run, and taken away when another takes its
place."""

RESERVED_NAMES = frozenset(
    {"run.json", "sha256sums", "sweep.csv", "sweep.csv-metadata.json", "sweep.json", "runs", ".claim", REPORT}
)

MAX_PART = 255
"""Bytes of a file's name; the limit of nearly every file system."""

MAX_NAME = 1000
"""Bytes of a path below the run directory."""

_DEVICE = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³]|conin\$|conout\$)( *\..*)?", re.IGNORECASE)
_FORBIDDEN = re.compile(r'[<>:"|?*\t\n\x85\u2028\u2029]')


def output_parts(name: str) -> tuple[str, ...]:
    """The parts of an output's name.

    Raises `ConfigError` if the name leaves the run directory, is kept for the run itself, or can't be a file's name
    everywhere.
    """
    # a backslash separates on Windows, and would leave the run directory there
    posix = PurePosixPath(name.replace("\\", "/"))
    parts = posix.parts
    if (bad := unprintable(name)) is not None:
        raise ConfigError(f"the output {shown(name)} holds the character {bad}, which no file name can")
    if not parts:
        raise ConfigError(f"an output needs a name, got {name!r}")
    if posix.is_absolute() or ".." in parts or ":" in parts[0]:
        raise ConfigError(
            f"the output {shown(name)} leaves the run directory",
            hint="outputs are relative to the run directory, which -o chooses",
        )
    # a file system may take names for one that differ in case
    if parts[0].casefold() in RESERVED_NAMES or parts[0].casefold().startswith(STAGING):
        raise ConfigError(f"the output {shown(name)} has a name that is kept for the run itself")
    if len(name.encode()) > MAX_NAME:
        raise ConfigError(f"the output {shown(name)} has more than {MAX_NAME} bytes in its name")
    for part in parts:
        if len(part.encode()) > MAX_PART:
            raise ConfigError(f"{shown(part)} is longer than the {MAX_PART} bytes that a file name can have")
        if found := _FORBIDDEN.search(part):
            raise ConfigError(f"the output {shown(name)} holds {found[0]!r}, which not every file system allows")
        if part.endswith((".", " ")) or part.startswith(" "):
            raise ConfigError(f"the output {shown(name)} has a part that begins with a blank or ends in a dot or blank")
        # runs are copied to other systems, so that Windows' names are refused everywhere
        if _DEVICE.fullmatch(part):
            raise ConfigError(f"{shown(part)} is the name of a device on Windows, not of a file")
    return parts


_LIKE_A_FILE = re.compile(r"\.[a-z]\w{1,4}", re.IGNORECASE)


def suffix_words(suffixes: Collection[str]) -> str:
    """Allowed names of an output: "a name that ends in .md or .csv"."""
    files = [suffix for suffix in suffixes if suffix != "/"]
    listed = f"{', '.join(files[:-1])} or {files[-1]}" if len(files) > 1 else "".join(files)
    words = [f"a name that ends in {listed}"] * bool(files) + ["the name of a folder"] * ("/" in suffixes)
    return " or ".join(words)


def fits_suffix(name: str, suffixes: Collection[str]) -> bool:
    """True if the name of an output ends as one of `suffixes` says; that of a folder ends like no file's."""
    suffix = PurePosixPath(name.replace("\\", "/")).suffix.lower()
    return not suffixes or suffix in suffixes or ("/" in suffixes and not _LIKE_A_FILE.fullmatch(suffix))


def folded(parts: tuple[str, ...]) -> tuple[str, ...]:
    """Equal for names that some file system takes for one: they may differ in case, or in how an accent is composed."""
    return tuple(unicodedata.normalize("NFC", unicodedata.normalize("NFC", part).casefold()) for part in parts)


def collide(one: tuple[str, ...], other: tuple[str, ...]) -> bool:
    """True if two folded names are the same, or one lies in the other."""
    short = min(len(one), len(other))
    return one[:short] == other[:short]


def clashes(claims: Iterable[tuple[str, str, Position]]) -> Problems:
    """Outputs of different stages that are one file, or of which one lies in the other; claims are (address of the
    stage, name of the output, place in the configuration).
    """
    problems: Problems = []
    seen: dict[tuple[str, ...], tuple[str, str]] = {}
    for stage, name, where in claims:
        key = folded(output_parts(name))
        other = next((seen[key_] for key_ in seen if collide(key_, key) and seen[key_][0] != stage), None)
        if other is None:
            seen[key] = (stage, name)
        else:
            message = f"the output {shown(name)} collides with {shown(other[1])} of stage {other[0]!r}"
            hint = "give one of them another path"
            problems.append(ConfigError(message, where=where, hint=hint, stage=stage))
    return problems
