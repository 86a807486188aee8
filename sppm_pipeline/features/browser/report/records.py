"""Run records as reports show them: without the folders of the disk, since reports are mailed to others."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from sppm_pipeline.engine.config.document import RECORD_KEY
from sppm_pipeline.engine.run.outputs import RECORD
from sppm_pipeline.errors import InputError

CUT = "…/"
"""Replaces the folders of an absolute path."""

_ROOT = r"(?:/|~/|[A-Za-z]:[\\/]|\\\\)"
_QUOTED = re.compile(rf"(?<=['\"`]){_ROOT}[^'\"`\n]*[\\/](?=[^'\"`\n]*['\"`])")  # may hold blanks
_BARE = re.compile(rf"(?<![\w.:/…~\\'\"`<-]){_ROOT}(?:[^\s'\"`,;:()\\/]+[\\/])+")


def read_record(path: Path) -> dict[str, Any]:
    """The record of a run, sound or not; `InputError` if the directory holds none."""
    try:
        record = json.loads((path / RECORD).read_bytes())
    except FileNotFoundError:
        raise InputError(
            f"{str(path)!r} holds no run: there is no {RECORD}", hint="name the directory of a run"
        ) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"{str(path / RECORD)!r} can't be read: {error}", hint="see `sppm verify`") from error
    if not isinstance(record, dict) or RECORD_KEY not in record:
        raise InputError(f"{str(path / RECORD)!r} is no record of a run")
    return record


def without_folders(value: Any) -> Any:
    """A JSON value in whose texts absolute paths are cut to their last name, and without the configuration's folder;
    relative paths stay: they are those of files of the run, or beside the configuration.
    """
    if isinstance(value, Mapping):
        # `folder` of a recorded configuration is where its relative paths begin
        config = "sppm" in value
        return {
            without_folders(key): without_folders(one) for key, one in value.items() if not (config and key == "folder")
        }
    if isinstance(value, (list, tuple)):
        return [without_folders(one) for one in value]
    if not isinstance(value, str):
        return value
    if "\n" not in value and _is_absolute(value):
        return CUT + (PurePosixPath(value) if value[0] in "/~" else PureWindowsPath(value)).name
    # quoted paths first, which may hold blanks; then what looks like one between blanks
    return _BARE.sub(CUT, _QUOTED.sub(CUT, value))


def _is_absolute(text: str) -> bool:
    """Test whether a text is one absolute path, which may hold blanks, and not a message that begins with one."""
    return re.match(rf"{_ROOT}.*[^\\/]$", text) is not None and re.search(r"\s([/~]|[A-Za-z]:[\\/])|: ", text) is None
