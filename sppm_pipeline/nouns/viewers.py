"""Viewers: what shows artifacts that can't show themselves, by type, from plugins' `sppm_live_views`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from sppm_pipeline.built_in import FEATURES


@dataclass(frozen=True)
class Viewer:
    """Functions that show artifacts of a type; they may be given as ``"module:function"``, imported when first used.

    Attributes
    ----------
    view : function (artifact, samples, threads) that returns the bytes of a view file, or "module:function"
        For ``write.view`` and reports; `samples` is how many samples it may hold, as far as it is sampled at all.
    picture : function (artifact) that returns a PNG file as bytes or None, or "module:function", optional
        For notebooks.
    frame : function (artifact) that returns HTML or an empty string, or "module:function", optional
        What notebooks show in place of the picture, because it moves.
    """

    view: Callable[..., bytes] | str
    picture: Callable[..., bytes | None] | str = ""
    frame: Callable[..., str] | str = ""

    def maker(self, name: str) -> Callable[..., Any]:
        """The function `view`, `picture` or `frame`."""
        found: Callable[..., Any] | str = getattr(self, name)
        if isinstance(found, str):
            module, _, function = found.partition(":")
            found = getattr(import_module(module), function)
        return found  # type: ignore[return-value]


_VIEWERS: dict[str, Viewer] = {}


def add_viewers(viewers: Mapping[str, Viewer]) -> None:
    """Register viewers by ``"module:Class"`` of the type that they show; a later one replaces an earlier one."""
    if not _VIEWERS:  # those of features are there before any plugin is loaded: notebooks need no pipeline
        for module in map(import_module, FEATURES):
            _VIEWERS.update(module.sppm_live_views() if hasattr(module, "sppm_live_views") else {})
    _VIEWERS.update(viewers)


def viewer_of(kind: type) -> Viewer | None:
    """The viewer of a type, or of the nearest type that it derives from; None if there is none."""
    add_viewers({})
    names = (f"{base.__module__}:{base.__qualname__}" for base in kind.__mro__)
    return next((_VIEWERS[name] for name in names if name in _VIEWERS), None)
