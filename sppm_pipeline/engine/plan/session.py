"""Everything needed to plan and run a configuration, from values that can be sent to another process."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.configuration import Configuration, parse_configuration
from sppm_pipeline.engine.config.document import Entry, compose, parse_yaml, read_yaml, yaml_text
from sppm_pipeline.engine.config.parameters import Overrides, sweep_rows, without_fixed_axes
from sppm_pipeline.engine.config.problems import Problems, did_you_mean, raise_problems
from sppm_pipeline.engine.plan.planning import Plan, draft_plan, wire_plan
from sppm_pipeline.engine.plan.plugins import Plugins, load_plugins
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.trust import UntrustedError, untrusted
from sppm_pipeline.errors import ConfigError


def find_configuration(name: str) -> Path:
    """A file by its path, or a packaged example by its name; `ConfigError` if there is neither."""
    path = Path(name)
    if path.exists():
        return path
    package = Path(__file__).resolve().parents[2]
    # a wheel carries them in the package; in a checkout they lie beside it
    home = package if (package / "configs").is_dir() else package.parent
    examples = {file.stem: file for folder in ("examples", "configs") for file in (home / folder).glob("*.yaml")}
    if name in examples:
        return examples[name]
    hint = did_you_mean(name, examples) if path.name == name and not path.suffix else None
    if hint is None:
        siblings = [p.name for p in path.parent.glob("*") if p.suffix in (".yaml", ".yml", ".json")]
        hint = did_you_mean(path.name, siblings) if siblings else None
    raise ConfigError(f"there is no configuration {name!r}", hint=hint)


Row = Mapping[str, Entry]
"""Values of a row of a sweep, by parameter."""


@dataclass(frozen=True)
class RunRequest:
    """A configuration to run and how to run it, in plain picklable values."""

    file: str  # with `text` or `document`, the name by which messages and the run record call it
    builtins: tuple[str, ...] = BUILTINS  # modules with the built-in hook implementations
    plugins: tuple[str, ...] = ()  # Python files with further stages
    distributions: bool = True  # whether installed plugins, and those the configuration names, are loaded
    overrides: Overrides = field(default_factory=Overrides)
    # installed plugins that may be imported, by distribution or entry point; all if None
    allowed: tuple[str, ...] | None = None
    text: str | None = None  # the configuration itself as YAML, instead of a file
    # the configuration as plain Python values; see `compose`
    document: Mapping[str, Any] | None = field(default=None, hash=False)
    folder: str | None = None  # where relative paths in `text` or `document` start; the current folder if None
    trusted: bool = False  # whether the user has agreed to run whatever Python files the configuration names

    def absolute(self) -> RunRequest:
        """The same for another process in another folder: the text of the configuration, which keeps its name."""
        # a worker can't ask the user, and runs what was agreed to here
        plugins = tuple(str(Path(path).absolute()) for path in self.plugins)
        if self.text is None and self.document is None:
            # the text travels, as the file may be changed or out of reach there
            text, folder = yaml_text(Path(self.file)), Path(self.file).parent
            return replace(self, plugins=plugins, text=text, folder=os.path.abspath(folder), trusted=True)
        return replace(self, plugins=plugins, folder=os.path.abspath(self.folder or "."), trusted=True)

    def read(self) -> tuple[Configuration, Problems]:
        """The configuration that is asked for, without the sweep axes that overrides fix, and what is wrong with it."""
        path, folder = Path(self.file), Path(self.folder or ".")
        if self.document is not None:
            root = compose(self.document, self.file)
        elif self.text is not None:
            root = parse_yaml(self.text, self.file)
        else:
            root, folder = read_yaml(path), path.parent
        configuration, problems = parse_configuration(root, path, folder)
        return without_fixed_axes(configuration, self.overrides), problems


@dataclass(frozen=True)
class Session:
    """A configuration that was read, with the plugins it needs."""

    request: RunRequest
    configuration: Configuration
    plugins: Plugins
    registry: Registry
    # errors of the top level that do not keep the rest from being looked at
    unread: Problems = field(default_factory=list)

    def plan(self, row: Row | None = None) -> Plan:
        """Plan the run, or one row of its sweep; raises all that is wrong."""
        drafts, unfit = draft_plan(self.configuration, self.registry, self.request.overrides, row)
        plan, loose = wire_plan(drafts)
        raise_problems([*self.unread, *unfit, *loose])
        return plan

    @cached_property
    def rows(self) -> Sequence[Row]:
        """Rows of the sweep, laid out once whatever their number; none of a single run. Raises as `sweep_rows` does."""
        sweep = self.configuration.sweep
        return [] if sweep is None else sweep_rows(sweep, self.configuration.params)


def open_session(request: RunRequest) -> Session:
    """Read the configuration and load the plugins.

    Raises `UntrustedError` if the configuration names Python files that the user has not agreed to run: neither as
    `RunRequest.trusted` and `RunRequest.plugins` say nor by name in `RunRequest.allowed`, nor by `trust.trust`.
    """
    configuration, unread = request.read()
    files = [Path(path) for path in request.plugins]
    if request.distributions:
        named = [path for path in configuration.plugins if request.allowed is None or path.name in request.allowed]
        agreed = request.trusted or request.allowed is not None
        # naming a file on the command line is agreement
        given = {path.resolve() for path in files}
        if not agreed and (unknown := untrusted(path for path in named if path.resolve() not in given)):
            raise UntrustedError(unknown)
        files += named
    # single files are no distributions, and were taken above
    names = None if request.allowed is None else [name for name in request.allowed if not name.endswith(".py")]
    plugins = load_plugins(request.builtins, files=files, distributions=request.distributions, allowed=names)
    plugins.raise_broken()
    return Session(request, configuration, plugins, Registry(plugins), unread)
