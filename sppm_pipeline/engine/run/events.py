"""Receivers of the events of a run: the monitor that shows it, and observers (`sppm_stage_finished`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import nullcontext
from typing import Any

import pluggy

from sppm_pipeline import hookspecs
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import PluginError, described
from sppm_pipeline.hookspecs import StageEvent


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


class Observers:
    """The implementations of `sppm_stage_finished` that hear of one run.

    The engine's own come first, and what they raise is raised; what one of a plugin raises becomes one warning for each
    plugin and changes nothing else.
    """

    def __init__(self, own: Iterable[object], plugins: Iterable[Plugin], warn: Callable[[str], None]) -> None:
        self._manager = pluggy.PluginManager(hookspecs.PROJECT)
        self._manager.add_hookspecs(hookspecs)
        self._plugins: dict[str, Plugin] = {}
        self._warn = warn
        for observer in own:
            self._manager.register(observer)
        for plugin in plugins:
            if plugin.module is not None and not self._manager.is_registered(plugin.module):
                self._plugins[plugin.name] = plugin
                self._manager.register(plugin.module, plugin.name)

    def stage_finished(self, event: StageEvent) -> None:
        """Call all of them; a plugin that raised once is not called again in this run."""
        for implementation in self._manager.hook.sppm_stage_finished.get_hookimpls():
            plugin = self._plugins.get(implementation.plugin_name)
            arguments = (event,) * len(implementation.argnames)
            if plugin is None:
                implementation.function(*arguments)
                continue
            try:
                with nullcontext() if plugin.builtin else contained(PluginError):
                    implementation.function(*arguments)
            except Exception as error:
                words = error.message if isinstance(error, PluginError) else f"raised {described(error)}"
                # once is enough: a broken observer would warn after each of a thousand stages
                self._manager.unregister(name=plugin.name)
                self._warn(f"{plugin}: sppm_stage_finished {words}; it is not called again in this run")
