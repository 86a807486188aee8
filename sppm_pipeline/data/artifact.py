"""What all artifacts share: read-only arrays, a digest of their content, a summary for the run record."""

from __future__ import annotations

import hashlib
import html
import importlib
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.errors import ResourceError


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

    def _repr_html_(self) -> str:
        """The summary as a table, as notebooks show it."""
        rows = "".join(f"<tr><th>{escaped(k)}</th><td>{escaped(shown(v))}</td></tr>" for k, v in self.summary().items())
        return f"<table><caption>{escaped(type(self).__name__)}</caption>{rows}</table>"


MOST_SHOWN = 200
"""Characters of a value that notebooks show."""


def shown(value: Any) -> str:
    """A value of a summary for people: numbers to six digits, long lists cut."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict):
        text = ", ".join(f"{key}: {shown(item)}" for key, item in value.items())
    elif isinstance(value, (list, tuple)):
        text = f"[{', '.join(shown(item) for item in value)}]"
    else:
        text = str(value)
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."


def escaped(text: str) -> str:
    """A name or value as HTML shows it, cut if it is very long."""
    return html.escape(text[: 2 * MOST_SHOWN])


def optional_module(name: str) -> Any:
    """A library that is used only where it is installed.

    Raises
    ------
    ResourceError
        If it is not.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise ResourceError(f"this needs {name}, which is not installed", hint=f"pip install {name}") from error


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
