"""Types of the results of a run, and sections that plugins add to a report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sppm_pipeline.engine.plan.plugins import Plugins
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.run.events import PluginHooks, list_of
from sppm_pipeline.errors import SppmError
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
    found: list[ReportSection] = []
    hooks = PluginHooks(plugins.plugins)
    for plugin, own, wrong in hooks.call("sppm_report_sections", record, list_of(ReportSection)):
        found += [ReportSection(str(plugin), f"sppm_report_sections {wrong}")] if wrong else own
    return found
