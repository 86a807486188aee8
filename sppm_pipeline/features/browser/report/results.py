"""Types of the results of a run, and sections that plugins add to a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import pluggy

from sppm_pipeline import hookspecs
from sppm_pipeline.engine.plan.plugins import Plugins
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import PluginError, SppmError, described
from sppm_pipeline.nouns.artifact import Artifact
from sppm_pipeline.nouns.report import ReportSection


def kinds_of(stages: Sequence[Mapping[str, Any]], registry: Registry) -> dict[str, type[Artifact]]:
    """The type of what each recorded stage made, by its id.

    It is that of this name among the results that the stages of the run and of its recipes announce, else what the
    stage itself announces; stages that are not known, because a plugin is not loaded, are left out.
    """
    known: dict[str, type[Artifact]] = {}
    announced: dict[str, type[Artifact]] = {}
    for stage in stages:
        for one in (stage, *stage.get("inner", ())):
            for kind in _announced(str(one.get("stage")), registry):
                known[kind.__name__] = kind
                announced.setdefault(str(one["id"]), kind)
    kinds = ((str(stage["id"]), known.get(str(stage.get("made")))) for stage in stages if stage.get("made"))
    return {id_: found for id_, kind in kinds if (found := kind or announced.get(id_)) is not None}


def _announced(name: str, registry: Registry) -> Iterator[type[Artifact]]:
    try:
        makes = signature_of(registry.get(name)).makes
    except SppmError:
        return
    yield from (kind for kind in makes if isinstance(kind, type) and issubclass(kind, Artifact))


def sections_of(record: Mapping[str, Any], plugins: Plugins) -> list[ReportSection]:
    """The sections of all plugins; what one raises stands in the place of its own."""
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    owners = {plugin.name: plugin for plugin in plugins.plugins if plugin.module is not None and plugin.error is None}
    for name, plugin in owners.items():
        if not manager.is_registered(plugin.module):
            manager.register(plugin.module, name)
    found: list[ReportSection] = []
    for implementation in manager.hook.sppm_report_sections.get_hookimpls():
        plugin = owners[implementation.plugin_name]
        try:
            with nullcontext() if plugin.builtin else contained(PluginError):
                arguments = (record,) * len(implementation.argnames)
                own: list[ReportSection] = [*implementation.function(*arguments)]  # type: ignore[misc]
                if not all(isinstance(section, ReportSection) for section in own):
                    raise TypeError("it must return instances of ReportSection")
        except Exception as error:
            words = error.message if isinstance(error, PluginError) else f"raised {described(error)}"
            own = [ReportSection(str(plugin), f"sppm_report_sections {words}")]
        found += own
    return found
