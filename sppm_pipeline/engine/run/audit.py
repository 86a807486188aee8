"""The audit of a run: plugins compare the numbers that its stages report, and a contradiction is a breach."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import pluggy

from sppm_pipeline import hookspecs
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import DesignError, PluginError, described
from sppm_pipeline.hookspecs import Comparison


class AuditBreach(DesignError):
    """The results of a run contradict each other or what was asked for."""


def audited(record: Mapping[str, Any], plugins: Sequence[Plugin], warn: Callable[[str], None]) -> dict[str, Any]:
    """The entry `audit` of a record that has the entries of all stages; what a plugin raises becomes a warning.

    ``verdict`` is "passed", "breach" or "nothing to compare".
    """
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    owners = {plugin.name: plugin for plugin in plugins if plugin.module is not None and plugin.error is None}
    for name, plugin in owners.items():
        if not manager.is_registered(plugin.module):
            manager.register(plugin.module, name)
    found: list[Comparison] = []
    for implementation in reversed(manager.hook.sppm_audit.get_hookimpls()):
        plugin = owners[implementation.plugin_name]
        try:
            with nullcontext() if plugin.builtin else contained(PluginError):
                # as pluggy calls hooks: an implementation may leave the argument out
                arguments = (record,) * len(implementation.argnames)
                own: list[Comparison] = [*implementation.function(*arguments)]  # type: ignore[misc]
                if not all(isinstance(one, Comparison) for one in own):
                    raise TypeError("it must return instances of Comparison")
        except Exception as error:
            words = error.message if isinstance(error, PluginError) else f"raised {described(error)}"
            warn(f"{plugin}: sppm_audit {words}")
            continue
        found += own
    breached = any(not one.holds for one in found)
    return {
        "verdict": "breach" if breached else "passed" if found else "nothing to compare",
        "comparisons": [_entry(one) for one in found],
    }


def _entry(one: Comparison) -> dict[str, Any]:
    numbers = {
        name: value if math.isfinite(value) else None for name, value in one._asdict().items() if name in _NUMBERS
    }
    return {"quantity": one.quantity, **numbers, "unit": one.unit, "holds": one.holds, "text": str(one)}


_NUMBERS = ("found", "expected", "tolerance")


def breaches(audit: Mapping[str, Any] | None) -> list[str]:
    """Comparisons of an audit that do not hold, in words."""
    return [one["text"] for one in (audit or {}).get("comparisons", ()) if not one["holds"]]


def breach_error(record: Mapping[str, Any]) -> AuditBreach | None:
    """The error for a run, or a sweep, whose record has breaches; None if it has none."""
    texts = breaches(record.get("audit"))
    texts += [f"run {run['run']}: {text}" for run in record.get("runs", ()) for text in run.get("breaches", ())]
    if not texts:
        return None
    return AuditBreach(
        f"audit: {'; '.join(texts)}",
        hint="the files are there, and may not be what you asked for; `audit: warn` in the configuration accepts them",
    )
