"""What all artifacts share: read-only arrays, a digest of their content, a summary for the run record."""

from __future__ import annotations

import hashlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def frozen(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only, C-contiguous version of `array`; copies only if somebody else could still write to it."""
    array = np.ascontiguousarray(array)
    if array.flags.writeable:
        if array.base is not None or not array.flags.owndata:
            array = array.copy()
        array.setflags(write=False)
    return array


class Artifact:
    """Base of everything a stage may make. Subclasses are frozen dataclasses."""

    def summary(self) -> dict[str, Any]:
        """Numbers that describe the artifact, JSON-ready, under plain names; they go into the run record."""
        return {}

    def check(self) -> None:
        """Raise `ValueError` if the parts contradict each other; the engine calls it on every result."""

    def digest(self) -> str:
        """SHA-256 of the artifact's public fields: type, names, array dtypes, shapes and bytes."""
        h = hashlib.sha256()
        _feed(h, self)
        return h.hexdigest()


def _feed(h: Any, value: Any) -> None:
    """Hash `value` with its type and length in front, so that different structures can't collide by concatenation."""
    record = isinstance(value, tuple) and hasattr(value, "_fields")
    if record or (is_dataclass(value) and not isinstance(value, type)):
        names = list(value._fields) if record else [f.name for f in fields(value) if f.compare]
        h.update(f"{type(value).__name__}{len(names)};".encode())
        for name in names:
            h.update(f"{name}=".encode())
            _feed(h, getattr(value, name))
    elif isinstance(value, np.ndarray):
        h.update(f"array{value.dtype.str}{value.shape};".encode())
        h.update(np.ascontiguousarray(value).data)
    elif isinstance(value, (tuple, list)):
        h.update(f"sequence{len(value)};".encode())
        for item in value:
            _feed(h, item)
    elif isinstance(value, dict):
        h.update(f"map{len(value)};".encode())
        for key in sorted(value, key=repr):
            _feed(h, key)
            _feed(h, value[key])
    elif value is None or isinstance(value, (bool, int, float, str)):
        h.update(f"{type(value).__name__}:{value!r};".encode())
    elif isinstance(value, np.generic):
        _feed(h, value.item())
    else:
        raise TypeError(f"{type(value).__name__} has no digest")
