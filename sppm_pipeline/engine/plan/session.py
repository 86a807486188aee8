"""Everything needed to plan and run a configuration, from values that can be sent to another process."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from sppm_pipeline.built_in import BUILTINS
from sppm_pipeline.engine.config.configuration import Configuration, parse_configuration, read_configuration
from sppm_pipeline.engine.config.document import Entry, compose, parse_yaml, yaml_text
from sppm_pipeline.engine.config.parameters import Overrides, sweep_rows, without_fixed_axes
from sppm_pipeline.engine.config.problems import Problems, did_you_mean
from sppm_pipeline.engine.plan.estimate import PlanEstimate, estimate_plan, refuse_what_cannot_fit
from sppm_pipeline.engine.plan.inputs import Columns, missing_inputs
from sppm_pipeline.engine.plan.planning import Plan, make_plan
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

    def read(self) -> Configuration:
        """The configuration that is asked for, without the sweep axes that overrides fix.

        Raises
        ------
        ConfigError
        """
        path = Path(self.file)
        if self.document is not None:
            configuration = parse_configuration(compose(self.document, self.file), path, self.folder or ".")
        elif self.text is not None:
            configuration = parse_configuration(parse_yaml(self.text, self.file), path, self.folder or ".")
        else:
            configuration = read_configuration(path)
        return without_fixed_axes(configuration, self.overrides)


@dataclass(frozen=True)
class Session:
    """A configuration that was read, with the plugins it needs."""

    request: RunRequest
    configuration: Configuration
    plugins: Plugins
    registry: Registry

    def plan(self, row: Mapping[str, Entry] | None = None) -> Plan:
        """Plan the run, or one row of its sweep; see `make_plan`."""
        return make_plan(self.configuration, self.registry, self.request.overrides, row)

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
    configuration = request.read()
    files = [Path(path) for path in request.plugins]
    if request.distributions:
        files += [path for path in configuration.plugins if request.allowed is None or path.name in request.allowed]
    names = None if request.allowed is None else [name for name in request.allowed if not name.endswith(".py")]
    plugins = load_plugins(request.builtins, files=files, distributions=request.distributions, allowed=names)
    plugins.raise_broken()
    return Session(request, configuration, plugins, Registry(plugins))


Row = Mapping[str, Entry]

MAX_CHECKED = 1000
"""Rows that are planned before any work."""

MAXIMUM_ROWS = 50
"""Rows of a sweep that are estimated; of more, evenly spread ones stand for all."""


def checked(session: Session, until: str | None = None, *, inputs: bool = True) -> tuple[Plan, Sequence[Row]]:
    """The plan and the rows of its sweep, none if there is no sweep; unless `inputs` is False, input files are there.

    Raises
    ------
    ConfigError
        With the errors of all of them.
    """
    problems = Problems()
    plan: Plan | None = None
    rows: Sequence[Row] = []
    try:
        plan = session.plan()
        check_until(plan, until)
        for missing in missing_inputs(plan, until) if inputs else ():
            problems.add(missing)
    except ConfigError as error:
        problems.add(error)
    if session.configuration.sweep is not None:
        try:
            rows = session.rows
            if plan is not None:
                columns = Columns(tuple(rows[0]))
                check_sweep(session, rows, until, inputs=inputs, planned=columns.add)
                for impossible in columns.impossible(plan):
                    problems.add(impossible)
        except ConfigError as error:
            problems.add(error)
    problems.raise_any()
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


def check_until(plan: Plan, until: str | None) -> None:
    """Raise `ConfigError` if the pipeline has no stage `until`."""
    ids = [step.id for step in plan.steps]
    if until is not None and until not in ids:
        raise ConfigError(f"--until: the pipeline has no stage {until!r}", hint=did_you_mean(until, ids))


def check_sweep(
    session: Session,
    rows: Sequence[Row],
    until: str | None = None,
    *,
    inputs: bool = True,
    planned: Callable[[Plan], object] = lambda plan: None,
) -> None:
    """Plan with every value that occurs, so that a bad one is found before any work; each plan is shown to `planned`.

    In a grid each value is tried once, with the first values of the other parameters; in a table each row. Of more
    than `MAX_CHECKED` a part is tried.
    """
    sweep = session.configuration.sweep
    first = rows[0]
    problems = Problems()
    if sweep is not None and isinstance(sweep.value, dict):
        rows = [row for row in rows if sum(row[name].node is not first[name].node for name in row) <= 1]
    if len(rows) > MAX_CHECKED:  # of a long range, values spread evenly over it stand for all, both ends among them
        rows = [*rows[: -1 : -(-len(rows) // MAX_CHECKED)], rows[-1]]
    for row in rows:
        try:
            plan = session.plan(row)
            planned(plan)
            for missing in missing_inputs(plan, until) if inputs else ():
                problems.add(missing)
        except ConfigError as error:
            problems.add(error)
    problems.raise_any()
