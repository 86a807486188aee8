"""The built-in stages and their former names, as the program itself finds them."""

from __future__ import annotations

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.built_in import stage_class as stage_class
from sppm_pipeline.engine.plan.plugins import load_plugins

_PLUGINS = load_plugins(BUILTINS, distributions=False)
_PLUGINS.raise_broken()

PLACES = {name: str(place) for plugin in _PLUGINS.plugins for name, place in plugin.stages.items()}
"""Stage name -> "module:Class"."""

BUILT_IN = tuple(PLACES)

STAGE_ALIASES = {former: alias for plugin in _PLUGINS.plugins for former, alias in plugin.aliases.items()}
