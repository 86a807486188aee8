"""Errors of a configuration, reported in one pass."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from sppm_pipeline.errors import ConfigError, ConfigErrors, SppmError

Problems = list[ConfigError]
"""Errors that a phase has found. Each phase returns it beside its value; `raise_problems` reports all together."""


def raise_problems(problems: Iterable[SppmError]) -> None:
    """Raise what was found, each message once, in the order of the file: the only error, or a `ConfigErrors` of all."""
    # rows of a sweep repeat what is wrong with all of them
    unique = {str(one): one for error in problems for one in getattr(error, "errors", (error,))}
    ordered = sorted(
        unique.values(), key=lambda e: (e.where.file, e.where.line, e.where.column) if e.where else ("", 0, 0)
    )
    if ordered:
        raise ordered[0] if len(ordered) == 1 else ConfigErrors(ordered)


def shown(value: Any, length: int = 60) -> str:
    """A value of a configuration as messages show it: on one line, not longer than `length`."""
    if isinstance(value, bool):
        return str(value).lower()
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a map"
    text = repr(list(value) if isinstance(value, tuple) else value)
    return text if len(text) <= length else f"{text[: length - 3]}..."
