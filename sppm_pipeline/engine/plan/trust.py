"""Trust on first use for Python files that a configuration names, which run with all rights of the user.

A configuration may come from anybody, and `sppm check` of it would run the files that it names. So such a file is
imported only if the user has agreed to it: its content is remembered by digest, so that a copy elsewhere is trusted
and an edit is not. Who edits files of his own names their folder in `SPPM_TRUST`, whose files are trusted as they are.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from sppm_pipeline.engine.config.problems import listed
from sppm_pipeline.errors import ConfigError

FOLDERS = "SPPM_TRUST"
"""Environment variable with folders, separated as in PATH, whose Python files may run."""

_PACKAGE = Path(__file__).resolve().parents[2]
_OWN = (_PACKAGE / "examples", _PACKAGE / "configs", _PACKAGE.parent / "examples", _PACKAGE.parent / "configs")
"""Folders of the examples of this program: in a wheel within the package, in a checkout beside it."""


class UntrustedError(ConfigError):
    """A configuration names Python files that the user has not agreed to."""

    def __init__(self, files: Sequence[Path]) -> None:
        names = listed(map(str, files))
        super().__init__(
            f"the configuration names Python code that has not run for you before, or was changed since: {names}",
            hint="read it, then `sppm check FILE --trust` remembers that you trust it; "
            f"files of your own are trusted in the folders that {FOLDERS} names; --no-plugins goes on without it",
        )
        self.files = tuple(files)


def untrusted(files: Iterable[Path]) -> list[Path]:
    """Those that may not run yet; what is not there is left for the import to refuse."""
    files = [path for path in files if path.is_file() and not _in_trusted_folder(path)]
    known = _remembered() if files else set()
    return [path for path in files if _digest(path) not in known]


def trust(files: Iterable[Path]) -> None:
    """Remember the content of files, which may run from now on; `OSError` if that can't be written down."""
    known = _remembered() | {_digest(path) for path in files}
    folder = _state_folder()
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False, encoding="utf-8") as file:
        json.dump({"sha256": sorted(known)}, file, indent=1)
    os.replace(file.name, folder / "trusted.json")


def _in_trusted_folder(path: Path) -> bool:
    named = [Path(name).expanduser() for name in os.environ.get(FOLDERS, "").split(os.pathsep) if name]
    place = path.resolve()
    # an installed program trusts its examples; a folder that others can write to is the user's own decision
    return any(place.is_relative_to(folder.resolve()) for folder in (*_OWN, *named))


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _remembered() -> set[str]:
    """Digests that were trusted; none if the file is not the user's own, as another user may have written them."""
    file = _state_folder() / "trusted.json"
    with contextlib.suppress(OSError, ValueError, KeyError, TypeError), file.open(encoding="utf-8") as opened:
        if not hasattr(os, "getuid") or os.fstat(opened.fileno()).st_uid == os.getuid():
            return set(json.load(opened)["sha256"])
    return set()


def _state_folder() -> Path:
    """Folder in which programs keep their state of a user."""
    if sys.platform == "win32":
        root = os.environ.get("LOCALAPPDATA")
    else:
        root = os.environ.get("XDG_STATE_HOME")
    return Path(root) / "sppm" if root else Path.home() / ".local" / "state" / "sppm"
