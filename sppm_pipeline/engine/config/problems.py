"""Errors of a configuration, reported in one pass, and guesses at what was meant."""

from __future__ import annotations

import difflib
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


def nearest(word: str, known: Iterable[str]) -> list[str]:
    """Up to three of `known` that look like `word`, or whose last part is the same; the nearest first."""
    candidates = sorted(set(known))
    if same := [name for name in candidates if name.lower() == word.lower()]:
        return same[:3]
    # 0.6 is difflib's default; not sensitive: only which hint is given
    near = difflib.get_close_matches(word, candidates, n=3, cutoff=0.6)
    if near:
        return near
    # a forgotten or wrong family: dart_throwing for sample.dart_throwing
    last = word.rsplit(".", 1)[-1]
    return [name for name in candidates if name.rsplit(".", 1)[-1] == last][:3]


def did_you_mean(word: str, known: Iterable[str]) -> str | None:
    """A hint naming the nearest of `known`; the whole list if it is short and nothing is near; else None."""
    candidates = sorted(set(known))
    if near := nearest(word, candidates):
        return f"did you mean {listed(near, 'or')}?"
    return f"known: {', '.join(candidates)}" if 0 < len(candidates) <= 12 else None


def listed(words: Iterable[str], conjunction: str = "and") -> str:
    """``'a', 'b' and 'c'``."""
    quoted = [repr(word) for word in words]
    if len(quoted) < 2:
        return "".join(quoted)
    return f"{', '.join(quoted[:-1])} {conjunction} {quoted[-1]}"


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
