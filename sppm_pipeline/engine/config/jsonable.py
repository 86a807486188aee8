"""Values as strict JSON has them."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from typing import Any


def jsonable(value: Any) -> Any:
    """`value` with numpy numbers and arrays as plain ones, tuples as lists, NaN and infinities as None.

    Raises
    ------
    TypeError
        If it can't be written as JSON.
    """
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, int):
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    if isinstance(value, (set, frozenset)):
        return [jsonable(item) for item in sorted(value)]
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):  # numpy's arrays and scalars
        return jsonable(value.tolist())
    raise TypeError(f"{type(value).__name__} can't be written as JSON")


def json_text(value: Any) -> str:
    """Indented strict JSON, a line end behind it; lists of numbers on one line."""
    return _text(value, "\n") + "\n"


def _text(value: Any, newline: str) -> str:
    inside = newline + " "
    if isinstance(value, dict) and value:
        items = [f"{json.dumps(str(k), ensure_ascii=False)}: {_text(v, inside)}" for k, v in value.items()]
        return "{" + inside + ("," + inside).join(items) + newline + "}"
    if isinstance(value, list) and any(isinstance(item, (dict, list)) and item for item in value):
        return "[" + inside + ("," + inside).join(_text(item, inside) for item in value) + newline + "]"
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
