"""Where built-in stages, executors and verbs come from: features are found by looking which folders there are."""

from __future__ import annotations

import os
from importlib import import_module
from typing import Any

import sppm_pipeline

_FOLDER = os.path.join(os.path.dirname(str(sppm_pipeline.__file__)), "features")

FEATURES = tuple(
    f"sppm_pipeline.features.{name}"
    for name in sorted(os.listdir(_FOLDER))
    if os.path.isfile(os.path.join(_FOLDER, name, "__init__.py"))
)
"""Modules of the features."""

BUILTINS = (
    "sppm_pipeline.method",
    *FEATURES,
    "sppm_pipeline.engine.run.executors",
    "sppm_pipeline.engine.cli.commands",
)
"""Modules whose hook implementations are always there."""


def stage_class(name: str) -> Any:
    """The class of a stage of the method or of a feature, by its name; `LookupError` if none of them has it."""
    for module in ("sppm_pipeline.method", *FEATURES):
        if place := import_module(module).sppm_stages().get(name):
            found = vars(import_module(place)).values()
            return next(cls for cls in found if isinstance(cls, type) and vars(cls).get("name") == name)
    raise LookupError(f"no built-in stage is called {name!r}")
