"""The built-in stages and their former names, and the stages that have reference pages, as the program finds them."""

from __future__ import annotations

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.plan.plugins import load_plugins
from sppm_pipeline.engine.plan.registry import Registry

DOCUMENTED = ("sppm-crushing", "sppm-tetrahedra")
"""Plugins whose stages are treated as built-in ones are: they have reference pages, and meet the same tests."""

_PLUGINS = load_plugins(BUILTINS, allowed=DOCUMENTED)
_PLUGINS.raise_broken()

PLACES = {name: str(place) for plugin in _PLUGINS.plugins for name, place in plugin.stages.items()}
"""Stage name -> "module:Class" of all that have reference pages."""

STAGES = tuple(PLACES)

BUILT_IN = tuple(name for plugin in _PLUGINS.plugins if plugin.builtin for name in plugin.stages)

STAGE_ALIASES = {former: alias for plugin in _PLUGINS.plugins for former, alias in plugin.aliases.items()}

stage_class = Registry(_PLUGINS).get
"""The class of a stage by its name."""
