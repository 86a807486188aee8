"""What hears of a run: the monitor that shows it, observers (`sppm_stage_finished`), and the audit (`sppm_audit`)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from typing import Any

import pluggy

from sppm_pipeline import hookspecs
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import DesignError, PluginError, described
from sppm_pipeline.hookspecs import Comparison, StageEvent


class Monitor:
    """Shows how a run goes on; this one shows nothing. Calls may come from several threads.

    A monitor may implement `sppm_stage_finished` as well; see `Observers`.
    """

    def stage_started(self, stage: str, number: int, total: int) -> None:
        """Stage `number`, counted from 1, of `total` begins."""

    def progress(self, stage: str, inner: bool, done: float, total: float, what: str) -> None:
        """The stage, or if `inner` a stage of a recipe that it repeats, has done so much."""

    def warning(self, stage: str | None, message: str) -> None:
        """Something that does not stop the run."""

    def sweep_started(self, about: str, total: int) -> None:
        """So many runs of a sweep begin, at the place that the executor describes, if it does."""

    def crew_started(self, about: str) -> None:
        """Workers begin to do parts of a stage's work, at the place that their executor describes."""

    def crew_left_out(self, why: str) -> None:
        """Workers were allowed for, and this process does a stage's work itself; said once."""

    def row_finished(self, done: int, total: int, row: Mapping[str, Any]) -> None:
        """One run of a sweep ended, well or not."""


class PluginHooks:
    """Hooks of plugins by name: what one raises is put into words, and built-in code runs as it is."""

    def __init__(self, plugins: Iterable[Plugin], own: Iterable[object] = ()) -> None:
        self.manager = pluggy.PluginManager(hookspecs.PROJECT)
        self.manager.add_hookspecs(hookspecs)
        self._plugins: dict[str, Plugin] = {}
        for observer in own:
            self.manager.register(observer)
        for plugin in plugins:
            if plugin.module is not None and plugin.error is None and not self.manager.is_registered(plugin.module):
                self._plugins[plugin.name] = plugin
                self.manager.register(plugin.module, plugin.name)

    def call(
        self, hook: str, argument: Any, take: Callable[[Any], Any] = lambda made: made
    ) -> Iterator[tuple[Plugin | None, Any, str]]:
        """Plugin, result (through `take`) and what is wrong of each implementation; only a plugin's may raise."""
        for implementation in getattr(self.manager.hook, hook).get_hookimpls():
            plugin = self._plugins.get(implementation.plugin_name)
            # as pluggy calls hooks: an implementation may leave the argument out
            arguments = (argument,) * len(implementation.argnames)
            if plugin is None:
                yield None, implementation.function(*arguments), ""
                continue
            try:
                with nullcontext() if plugin.builtin else contained(PluginError):
                    found = take(implementation.function(*arguments))
            except Exception as error:
                yield plugin, None, error.message if isinstance(error, PluginError) else f"raised {described(error)}"
            else:
                yield plugin, found, ""


def list_of(kind: type) -> Callable[[Iterable[Any]], list[Any]]:
    """What takes the result of a hook that returns a sequence of a type; `TypeError` if it holds another."""

    def take(made: Iterable[Any]) -> list[Any]:
        found = [*made]
        if not all(isinstance(one, kind) for one in found):
            raise TypeError(f"it must return instances of {kind.__name__}")
        return found

    return take


class Observers:
    """The implementations of `sppm_stage_finished` that hear of one run.

    The engine's own come first, and what they raise is raised; what one of a plugin raises becomes one warning for each
    plugin and changes nothing else.
    """

    def __init__(self, own: Iterable[object], plugins: Iterable[Plugin], warn: Callable[[str], None]) -> None:
        self._hooks = PluginHooks(plugins, own)
        self._warn = warn

    def stage_finished(self, event: StageEvent) -> None:
        """Call all of them; a plugin that raised once is not called again in this run."""
        for plugin, _, wrong in self._hooks.call("sppm_stage_finished", event):
            if plugin is not None and wrong:
                # once is enough: a broken observer would warn after each of a thousand stages
                self._hooks.manager.unregister(name=plugin.name)
                self._warn(f"{plugin}: sppm_stage_finished {wrong}; it is not called again in this run")


class AuditBreach(DesignError):
    """The results of a run contradict each other or what was asked for."""


def audited(record: Mapping[str, Any], plugins: Sequence[Plugin], warn: Callable[[str], None]) -> dict[str, Any]:
    """The entry `audit` of a record that has the entries of all stages; what a plugin raises becomes a warning.

    ``verdict`` is "passed", "breach" or "nothing to compare".
    """
    found: list[Comparison] = []
    for plugin, own, wrong in reversed([*PluginHooks(plugins).call("sppm_audit", record, list_of(Comparison))]):
        if wrong:
            warn(f"{plugin}: sppm_audit {wrong}")
        else:
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
