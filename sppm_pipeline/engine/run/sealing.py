"""JSON files that know when a byte of theirs has changed: the last entry is the digest of the text without it."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from sppm_pipeline.engine.config.jsonable import json_text

SEAL = "sha256"
"""Key of the digest, the last of the file."""

_END = re.compile(rb',\n "sha256": "([0-9a-f]{64})"\n\}\n\Z')


class BrokenSealError(ValueError):
    """The text is not what was written."""


def sealed(value: Mapping[str, Any]) -> dict[str, Any]:
    """`value` with its digest as last entry; `json_text` of it is what `read_sealed` accepts."""
    bare = {key: item for key, item in value.items() if key != SEAL}
    return {**bare, SEAL: hashlib.sha256(json_text(bare).encode()).hexdigest()}


def read_sealed(data: bytes) -> dict[str, Any]:
    """The content of a sealed file.

    Raises
    ------
    BrokenSealError
        If it has no seal, or the seal does not fit.
    """
    end = _END.search(data)
    if end is None:
        raise BrokenSealError("the digest at its end is missing")
    if hashlib.sha256(data[: end.start()] + b"\n}\n").hexdigest() != end[1].decode():
        raise BrokenSealError("its content does not fit its digest")
    value: dict[str, Any] = json.loads(data)
    return value
