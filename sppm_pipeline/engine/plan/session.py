"""Everything needed to plan and run a configuration, from values that can be sent to another process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import Configuration, read_configuration
from sppm_pipeline.engine.config.document import Entry
from sppm_pipeline.engine.config.substitution import Overrides
from sppm_pipeline.engine.plan.planning import Plan, make_plan
from sppm_pipeline.engine.plan.plugins import Plugins, load_plugins
from sppm_pipeline.engine.plan.registry import Registry


@dataclass(frozen=True)
class RunRequest:
    """What to run and how, in plain picklable values.

    Attributes
    ----------
    file : str
        The configuration.
    builtins : tuple of str
        Modules with the built-in hook implementations.
    plugins : tuple of str
        Python files with further stages.
    distributions : bool
        Whether installed plugins, and those the configuration names, are loaded.
    overrides : Overrides
    allowed : tuple of str or None
        Installed plugins that may be imported, by distribution or entry point; all if None.
    """

    file: str
    builtins: tuple[str, ...]
    plugins: tuple[str, ...] = ()
    distributions: bool = True
    overrides: Overrides = field(default_factory=Overrides)
    allowed: tuple[str, ...] | None = None

    def absolute(self) -> RunRequest:
        """The same with absolute plugin files; the configuration keeps its name, which messages show."""
        return replace(self, plugins=tuple(str(Path(path).absolute()) for path in self.plugins))


@dataclass(frozen=True)
class Session:
    """A configuration that was read, with the plugins it needs."""

    order: RunRequest
    configuration: Configuration
    plugins: Plugins
    registry: Registry

    def plan(self, row: Mapping[str, Entry] | None = None) -> Plan:
        """Plan the run, or one row of its sweep; see `make_plan`."""
        return make_plan(self.configuration, self.registry, self.order.overrides, row)


def open_session(order: RunRequest) -> Session:
    """Read the configuration and load the plugins.

    Raises
    ------
    ConfigError, PluginError
    """
    configuration = without_fixed_axes(read_configuration(Path(order.file)), order.overrides)
    files: list[Any] = [Path(path) for path in order.plugins]
    if order.distributions:
        files += [path for path in configuration.plugins if order.allowed is None or path.name in order.allowed]
    names = None if order.allowed is None else [name for name in order.allowed if not name.endswith(".py")]
    plugins = load_plugins(order.builtins, files=files, distributions=order.distributions, allowed=names)
    plugins.raise_broken()
    return Session(order, configuration, plugins, Registry(plugins))


def without_fixed_axes(configuration: Configuration, overrides: Overrides) -> Configuration:
    """The configuration without the axes of a sweep that the command line gives one value.

    ``-p cells=[8, 8, 8]`` of a sweep over `cells` asks for that value and no other. Without axes there is no sweep
    left, and nothing comes after it.
    """
    sweep = configuration.sweep
    fixed = {text.partition("=")[0].strip() for text in overrides.params}
    if overrides.seed is not None:
        fixed.add("seed")
    if sweep is None or not fixed:
        return configuration
    if isinstance(sweep.value, dict):
        left: Any = {name: entry for name, entry in sweep.value.items() if name not in fixed}
    elif all(isinstance(row.value, dict) for row in sweep.value):
        rows = [
            replace(row, value={name: entry for name, entry in row.value.items() if name not in fixed})
            for row in sweep.value
        ]
        left = rows if any(row.value for row in rows) else []
    else:
        return configuration
    if not left:
        return replace(configuration, sweep=None, after=None)
    return replace(configuration, sweep=replace(sweep, value=left))
