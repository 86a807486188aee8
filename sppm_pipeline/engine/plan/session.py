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
from sppm_pipeline.engine.plan.estimate import PlanEstimate, estimate_plan, refuse_what_cannot_fit
from sppm_pipeline.engine.plan.inputs import Columns, missing_inputs
from sppm_pipeline.engine.plan.planning import Plan, draft_plan, wire_plan
from sppm_pipeline.engine.plan.plugins import Plugins, load_plugins
from sppm_pipeline.engine.plan.rates import Speed
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.errors import ConfigError


def find_configuration(name: str) -> Path:
    """A file by its path, or a packaged example by its name.

    Raises
    ------
    ConfigError
        If there is neither.
    """
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


@dataclass(frozen=True)
class RunRequest:
    """What to run and how, in plain picklable values.

    Attributes
    ----------
    file : str
        The configuration file; with `text` or `document`, the name by which messages and the run record call it.
    builtins : tuple of str
        Modules with the built-in hook implementations.
    plugins : tuple of str
        Python files with further stages.
    distributions : bool
        Whether installed plugins, and those the configuration names, are loaded.
    overrides : Overrides
    allowed : tuple of str or None
        Installed plugins that may be imported, by distribution or entry point; all if None.
    text : str or None
        The configuration itself as YAML, instead of a file.
    document : mapping or None
        The configuration as plain Python values, instead of a file; see `compose`.
    folder : str or None
        Folder that relative paths in `text` or `document` start from; the current folder if None.
    """

    file: str
    builtins: tuple[str, ...] = BUILTINS
    plugins: tuple[str, ...] = ()
    distributions: bool = True
    overrides: Overrides = field(default_factory=Overrides)
    allowed: tuple[str, ...] | None = None
    text: str | None = None
    document: Mapping[str, Any] | None = field(default=None, hash=False)
    folder: str | None = None

    def absolute(self) -> RunRequest:
        """The same for another process in another folder: the text of the configuration, which keeps its name."""
        plugins = tuple(str(Path(path).absolute()) for path in self.plugins)
        if self.text is None and self.document is None:
            text, folder = yaml_text(Path(self.file)), Path(self.file).parent
            return replace(self, plugins=plugins, text=text, folder=os.path.abspath(folder))
        return replace(self, plugins=plugins, folder=os.path.abspath(self.folder or "."))

    def read(self) -> tuple[Configuration, Problems]:
        """The configuration that is asked for, without the sweep axes that overrides fix.

        Raises
        ------
        ConfigError
        """
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
    """A configuration that was read, with the plugins it needs.

    Attributes
    ----------
    request : RunRequest
    configuration : Configuration
    plugins : Plugins
    registry : Registry
    unread : list of ConfigError
        What is wrong with the top level of the configuration and does not keep the rest from being looked at.
    """

    request: RunRequest
    configuration: Configuration
    plugins: Plugins
    registry: Registry
    unread: Problems = field(default_factory=list)

    def plan(self, row: Row | None = None) -> Plan:
        """Plan the run, or one row of its sweep; see `planned`.

        Raises
        ------
        ConfigError
            With all that is wrong.
        """
        plan, problems = planned(self, row)
        raise_problems(problems)
        assert plan is not None
        return plan

    @cached_property
    def rows(self) -> Sequence[Row]:
        """Rows of the sweep, laid out once whatever their number; none of a single run.

        Raises
        ------
        ConfigError
            See `sweep_rows`.
        """
        sweep = self.configuration.sweep
        return [] if sweep is None else sweep_rows(sweep, self.configuration.params)


def open_session(request: RunRequest) -> Session:
    """Read the configuration and load the plugins.

    Raises
    ------
    ConfigError, PluginError
    """
    configuration, unread = request.read()
    files = [Path(path) for path in request.plugins]
    if request.distributions:
        files += [path for path in configuration.plugins if request.allowed is None or path.name in request.allowed]
    names = None if request.allowed is None else [name for name in request.allowed if not name.endswith(".py")]
    plugins = load_plugins(request.builtins, files=files, distributions=request.distributions, allowed=names)
    plugins.raise_broken()
    return Session(request, configuration, plugins, Registry(plugins), unread)


Row = Mapping[str, Entry]

MAX_CHECKED = 1000
"""Rows that are planned before any work."""

MAXIMUM_ROWS = 50
"""Rows of a sweep that are estimated; of more, evenly spread ones stand for all."""


def planned(session: Session, row: Row | None = None) -> tuple[Plan | None, Problems]:
    """The plan of the run, or of one row of its sweep; None if anything is wrong.

    Raises
    ------
    PluginError
        If a stage breaks its contract.
    """
    try:
        drafts, unfit = draft_plan(session.configuration, session.registry, session.request.overrides, row)
    except ConfigError as error:
        return None, [error]
    plan, loose = wire_plan(drafts)
    problems = [*session.unread, *unfit, *loose]
    return None if problems else plan, problems


def checked(session: Session, until: str | None = None, *, inputs: bool = True) -> tuple[Plan, Sequence[Row]]:
    """The plan and the rows of its sweep, none if there is no sweep; unless `inputs` is False, input files are there.

    Raises
    ------
    ConfigError
        With the errors of all of them.
    """
    plan, problems = planned(session)
    rows: Sequence[Row] = []
    if plan is not None:
        try:
            plan.until(until)
            problems += missing_inputs(plan, until) if inputs else []
        except ConfigError as error:
            problems.append(error)
    try:
        rows = session.rows
    except ConfigError as error:
        problems.append(error)
    if rows and plan is not None:
        problems += sweep_problems(session, plan, rows, until, inputs=inputs)
    raise_problems(problems)
    assert plan is not None
    return plan, rows


def estimates(
    session: Session, plan: Plan, rows: Sequence[Row], until: str | None = None, speed: Speed | None = None
) -> list[PlanEstimate]:
    """The estimate of the plan, or of the rows of its sweep."""
    if not rows:
        return [estimate_plan(plan, until=until, speed=speed)]
    step = -(-len(rows) // MAXIMUM_ROWS)
    return [estimate_plan(session.plan(row), until=until, speed=speed) for row in rows[::step]]


def refuse_unfit(
    session: Session,
    plan: Plan,
    rows: Sequence[Row],
    folder: Path,
    *,
    workers: int = 1,
    crew: int = 0,
    until: str | None = None,
) -> None:
    """Raise `ResourceError` if the run or any of a sweep's can't fit into memory or onto the disk.

    Of a sweep `workers` runs go at the same time; a single run may have a `crew` of worker processes on this machine.
    """
    found = estimates(session, plan, rows, until)
    runs = max(1, len(rows))
    for estimate in found:
        refuse_what_cannot_fit(estimate, folder, workers=min(workers, runs), crew=0 if rows else crew)
    if runs > 1:
        total = sum(estimate.disk for estimate in found) / len(found) * runs
        largest = max(found, key=lambda estimate: estimate.disk)
        if largest.disk:
            refuse_what_cannot_fit(largest, folder, runs=round(total / largest.disk) or 1)


def sweep_problems(
    session: Session, plan: Plan, rows: Sequence[Row], until: str | None = None, *, inputs: bool = True
) -> Problems:
    """What is wrong with any value that occurs in a sweep, and with the columns that stages of `after` name.

    In a grid each value is tried once, with the first values of the other parameters; in a table each row. Of more
    than `MAX_CHECKED` a part is tried.
    """
    sweep = session.configuration.sweep
    columns = Columns(tuple(rows[0]))
    problems: Problems = []
    if sweep is not None and isinstance(sweep.value, dict):
        first = rows[0]
        rows = [row for row in rows if sum(row[name].node is not first[name].node for name in row) <= 1]
    if len(rows) > MAX_CHECKED:  # of a long range, values spread evenly over it stand for all, both ends among them
        rows = [*rows[: -1 : -(-len(rows) // MAX_CHECKED)], rows[-1]]
    for row in rows:
        one, wrong = planned(session, row)
        problems += wrong
        if one is not None:
            columns.add(one)
            problems += missing_inputs(one, until) if inputs else []
    return problems or columns.impossible(plan)
