"""Strict JSON: numbers and arrays of results as plain values, and files whose last entry is their own digest."""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping
from typing import Any


def jsonable(value: Any) -> Any:
    """`value` as JSON has it, or `TypeError`: numpy's numbers and arrays, tuples, NaN and infinities become plain ones.

    Arrays and tuples become lists, NaN and infinities None.
    """
    plain: Any
    if value is None or isinstance(value, (bool, str)):
        plain = value
    elif isinstance(value, float):  # NumPy's float64 is one, and becomes Python's
        plain = float(value) if math.isfinite(value) else None
    elif isinstance(value, int):
        plain = int(value)
    elif isinstance(value, Mapping):
        plain = {str(key): jsonable(item) for key, item in value.items()}
    elif isinstance(value, (list, tuple)):
        plain = [jsonable(item) for item in value]
    elif isinstance(value, (set, frozenset)):
        plain = [jsonable(item) for item in sorted(value)]
    elif isinstance(value, os.PathLike):
        plain = os.fspath(value)
    elif hasattr(value, "tolist"):  # NumPy's arrays and scalars
        plain = jsonable(value.tolist())
    else:
        raise TypeError(f"{type(value).__name__} can't be written as JSON")
    return plain


def json_text(value: Any) -> str:
    """Indented strict JSON, a line end behind it; lists of numbers on one line."""
    return _text(value, "\n") + "\n"


def _text(value: Any, newline: str) -> str:
    inside = newline + " "
    if isinstance(value, dict) and value:
        items = [f"{_encoded(str(k))}: {_text(v, inside)}" for k, v in value.items()]
        return "{" + inside + ("," + inside).join(items) + newline + "}"
    if isinstance(value, list) and any(isinstance(item, (dict, list)) and item for item in value):
        return "[" + inside + ("," + inside).join(_text(item, inside) for item in value) + newline + "]"
    return _encoded(value)


_encoded = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
"""Made once: `json.dumps` would make one for each value."""

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
    """The content of a sealed file; `BrokenSealError` if it has no seal, or the seal does not fit."""
    end = _END.search(data)
    if end is None:
        raise BrokenSealError("the digest at its end is missing")
    if hashlib.sha256(data[: end.start()] + b"\n}\n").hexdigest() != end[1].decode():
        raise BrokenSealError("its content does not fit its digest")
    value: dict[str, Any] = json.loads(data)
    return value
