"""From a configuration and overrides to a plan: parameters put in, options checked, stages wired, before any work."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import FORMAT, Configuration, StageEntry, stage_entries
from sppm_pipeline.engine.config.document import Entry, Node, as_node, plain
from sppm_pipeline.engine.config.names import refuse_clashes
from sppm_pipeline.engine.config.options import (
    current_name,
    options_of,
    parse_options,
    plain_option,
    with_current_names,
)
from sppm_pipeline.engine.config.parameters import Overrides, Substitution, override_options, override_params
from sppm_pipeline.engine.config.presets import expanded, stages_of
from sppm_pipeline.engine.config.problems import Problems
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.wiring import Draft, Step, recipe_names, recipe_order, wire
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import ConfigError, PluginError, Position, SppmError
from sppm_pipeline.hookspecs import Preset
from sppm_pipeline.stage import Stage

SWEEP_ID = "sweep"
"""Id under which the stages of `after` find the table of the sweep."""


@dataclass(frozen=True)
class Plan:
    """Everything that is known before the first stage runs.

    Attributes
    ----------
    configuration : Configuration
    name : str
    seed : int
    params : mapping of name to value
    steps : tuple of Step
    recipes : mapping of recipe name to tuple of Step
    after : tuple of Step
        Stages that run once after a sweep.
    warnings : tuple of str
    document : dict
        The configuration with overrides and defaults written out; run again, it gives the same.
    plugins : tuple of Plugin
        All that were loaded.
    """

    configuration: Configuration
    name: str
    seed: int
    params: Mapping[str, Any]
    steps: tuple[Step, ...]
    recipes: Mapping[str, tuple[Step, ...]]
    after: tuple[Step, ...]
    warnings: tuple[str, ...]
    document: dict[str, Any] = field(repr=False)
    plugins: tuple[Plugin, ...] = field(repr=False)

    def until(self, until: str | None) -> tuple[Step, ...]:
        """The steps of the pipeline up to the one of this id; all if it is None."""
        ids = [step.id for step in self.steps]
        return self.steps if until is None else self.steps[: ids.index(until) + 1]


def make_plan(
    configuration: Configuration,
    registry: Registry,
    overrides: Overrides = Overrides(),  # noqa: B008 - frozen
    row: Mapping[str, Entry] | None = None,
    available: Mapping[str, tuple[type, ...]] | None = None,
) -> Plan:
    """Check options, then wiring, and report all errors in one go.

    Parameters
    ----------
    configuration : Configuration
    registry : Registry
    overrides : Overrides
    row : mapping of parameter name (or ``seed``) to Entry, optional
        A row of the sweep; the plan is then that of a single run.
    available : mapping of id to artifact types, optional
        What is there before the first stage.

    Raises
    ------
    ConfigError
        The only error, or a `ConfigErrors` of all.
    PluginError
        If a stage breaks its contract.
    """
    problems = Problems()
    for known in configuration.errors:
        problems.add(known)
    params = override_params(configuration.params, overrides.params, problems)
    seed = configuration.seed if overrides.seed is None else overrides.seed
    if row is not None:
        params |= {name: entry for name, entry in row.items() if name != "seed"}
        seed = row["seed"].node.value if "seed" in row else seed
    entries, unused = _entries(configuration, params, overrides, registry.presets, problems)
    names = [name for name in entries if name not in (_PIPELINE, _AFTER)]
    renamed: dict[tuple[str, str], str] = {}
    drafts = {name: _drafts(group, configuration, registry, problems, renamed) for name, group in entries.items()}
    recipes: dict[str, tuple[type, ...] | None] = dict.fromkeys(names)
    wired: dict[str, list[Step]] = {}
    measured = {
        name
        for group in drafts.values()
        for draft in group
        if draft is not None and draft.cls.returns is not None
        for name, _ in recipe_names(draft.entry.recipes)
    }
    for name in recipe_order({name: drafts[name] for name in recipes}, problems):
        wired[name], recipes[name] = wire(drafts[name], recipes, problems, inside=wired)
        if recipes[name] == () and entries[name] and name not in measured:
            problems.report(f"the recipe {name!r} ends in a stage that makes nothing", entries[name][-1].where)
    steps, _ = wire(drafts[_PIPELINE], recipes, problems, given=available, inside=wired)
    after: list[Step] = []
    if configuration.after is not None:
        after, _ = wire(drafts[_AFTER], recipes, problems, given={SWEEP_ID: (_table(),)}, inside=wired)
    for group in ([*steps, *(step for name in names for step in wired.get(name, ()))], after):
        refuse_clashes(_claims(group), problems)
    problems.raise_any()
    used = {name for group in (steps, after, *wired.values()) for step in group for name in step.recipes.values()}
    if not any(_recipe_chosen(step.entry.recipes) for group in (steps, after, *wired.values()) for step in group):
        unused += [
            f"{entry.where}: the recipe {name!r} is not used"
            for name, entry in configuration.recipes.items()
            if name not in used
        ]
    return Plan(
        configuration=configuration,
        name=configuration.name,
        seed=seed,
        params={name: plain(entry.node) for name, entry in params.items()},
        steps=tuple(steps),
        recipes={name: tuple(wired[name]) for name in names},
        after=tuple(after),
        warnings=(*renamed.values(), *unused),
        document=_document(
            configuration, seed, params, steps, {name: wired[name] for name in names}, after, single=row is not None
        ),
        plugins=tuple(registry.plugins.plugins),
    )


def _recipe_chosen(node: Node | None) -> bool:
    """Whether a parameter says which recipe a stage is handed; the others are then there to be chosen."""
    return node is not None and _has_param(node)


def _claims(steps: Sequence[Step]) -> Iterator[tuple[str, str, Position]]:
    """The outputs that options name: stage, name, place."""
    for step in steps:
        for name, option in options_of(type(step.stage)).items():
            value = getattr(step.stage, name)
            if option.spec.output and value is not None:
                written = step.entry.options.get(name)
                yield step.address, value, written.node.where if written else step.where


_PIPELINE = ""
_AFTER = "after:"  # no recipe can have these names


def _table() -> type:
    """The artifact of a sweep's table; imported late because artifacts import numpy."""
    table: type = importlib.import_module("sppm_pipeline.nouns.table").Table
    return table


def _entries(
    configuration: Configuration,
    params: Mapping[str, Entry],
    overrides: Overrides,
    presets: Mapping[str, Preset],
    problems: Problems,
) -> tuple[dict[str, list[StageEntry]], list[str]]:
    """Stage entries of the recipes, the pipeline and `after`, parameters and overrides put in; and warnings.

    Presets that are named without being written down become recipes.
    """
    substitution = Substitution(params, problems)
    groups: dict[str, Node] = {name: entry.node for name, entry in configuration.recipes.items()}
    groups[_PIPELINE] = configuration.pipeline
    if configuration.after is not None:
        groups[_AFTER] = configuration.after
    entries = {
        key: stage_entries(
            expanded(substitution.apply(node), presets, problems),
            None if key in (_PIPELINE, _AFTER) else key,
            problems,
        )
        for key, node in groups.items()
    }
    named = [entry.recipes for group in entries.values() for entry in group if entry.recipes is not None]
    for name, where in (found for node in named for found in recipe_names(node)):
        if name not in entries and name in presets:
            entries[name] = stage_entries(stages_of(presets[name], where), name, problems)
    flat = override_options([entry for group in entries.values() for entry in group], overrides.options, problems)
    changed = iter(flat)
    entries = {key: [next(changed) for _ in group] for key, group in entries.items()}
    return entries, substitution.unused()


def _drafts(
    entries: Sequence[StageEntry],
    configuration: Configuration,
    registry: Registry,
    problems: Problems,
    renamed: dict[tuple[str, str], str],
) -> list[Draft | None]:
    """Look the stages up and read their options; former names that are used go to `renamed`, each once."""
    drafts: list[Draft | None] = []
    for entry in entries:
        try:
            cls = registry.get(entry.name, entry.stage.where)
        except ConfigError as error:
            problems.add(error)
            drafts.append(None)
            continue
        except PluginError as error:
            error.where = error.where or entry.where
            raise
        entry = _with_current_names(entry, cls, registry, problems, renamed)
        values = parse_options(cls, entry.options, entry.where, configuration.base_of, problems, stage=entry.address)
        stage = None
        if values is not None:
            try:
                owner = registry.owner(entry.name)
                with nullcontext() if owner.builtin else contained(_fault_of(owner, entry)):
                    stage = cls(**values)
                    stage.check_options()
            except SppmError as error:
                error.where, error.stage = error.where or entry.where, error.stage or entry.address
                if not isinstance(error, ConfigError):
                    raise
                problems.add(error)
                stage = None
            except Exception as error:
                raise PluginError(
                    f"{registry.owner(entry.name)}: checking the options raised {type(error).__name__}: {error}",
                    where=entry.where,
                    stage=entry.address,
                ) from error
        drafts.append(Draft(entry, cls, stage, registry.owner(entry.name)))
    return drafts


def _with_current_names(
    entry: StageEntry, cls: type[Stage], registry: Registry, problems: Problems, renamed: dict[tuple[str, str], str]
) -> StageEntry:
    """The entry with options under their current names, and those that a former name of the stage implied."""
    options, former = with_current_names(cls, entry.options, problems, stage=entry.address)
    for name in former:
        renamed.setdefault(
            (cls.name, name),
            f"{entry.options[name].where}: the option {name!r} of {cls.name} is now "
            f"{current_name(cls, name)!r}; the old name works in this version",
        )
    alias = registry.aliases.get(entry.name)
    if alias is not None:
        renamed.setdefault(
            (entry.name, ""),
            f"{entry.stage.where}: stage {entry.name!r} is now {cls.name!r}; the old name works in this version",
        )
        written = {name: plain(one.node) for name, one in options.items()}
        try:
            implied = alias.options(written) if callable(alias.options) else alias.options
        except ConfigError as error:
            error.where, error.stage = error.where or entry.where, error.stage or entry.address
            problems.add(error)
            implied = {}
        for name, value in implied.items():
            options.setdefault(name, Entry(entry.where, as_node(plain_option(value), entry.where)))
    return dataclasses.replace(entry, options=options, stage=dataclasses.replace(entry.stage, value=cls.name))


def _fault_of(owner: Plugin, entry: StageEntry) -> Callable[[str], SppmError]:
    def fault(message: str) -> SppmError:
        return PluginError(f"{owner}: checking the options {message}", where=entry.where, stage=entry.address)

    return fault


def step_options(step: Step) -> dict[str, Any]:
    """All options of a step, defaults included, JSON-ready."""
    return {name: plain_option(getattr(step.stage, name)) for name in options_of(type(step.stage))}


def _document(
    configuration: Configuration,
    seed: int,
    params: Mapping[str, Entry],
    steps: Sequence[Step],
    recipes: Mapping[str, Sequence[Step]],
    after: Sequence[Step],
    *,
    single: bool,
) -> dict[str, Any]:
    """The configuration as a run record keeps it."""
    paths = {
        entry.node.param
        for group in (steps, after, *recipes.values())
        for step in group
        for name, entry in step.entry.options.items()
        if entry.node.param is not None and isinstance(getattr(step.stage, name), Path)
    }

    def param_value(name: str, node: Node) -> Any:
        value = plain(node)
        return str(configuration.base_of(node.where) / value) if name in paths and isinstance(value, str) else value

    document: dict[str, Any] = {
        "sppm": FORMAT,
        "name": configuration.name,
        "seed": seed,
        "folder": str(configuration.folder),
    }
    if params:
        document["params"] = {name: param_value(name, entry.node) for name, entry in params.items()}
    if configuration.plugins:
        document["plugins"] = [str(path.absolute()) for path in configuration.plugins]
    if recipes:
        document["recipes"] = {name: [_entry(step) for step in steps] for name, steps in recipes.items()}
    document["pipeline"] = [_entry(step) for step in steps]
    if configuration.sweep is not None and not single:
        document["sweep"] = _sweep(configuration.sweep, param_value)
        if after:
            document["after"] = [_entry(step) for step in after]
    return document


def _sweep(sweep: Node, param_value: Any) -> Any:
    """The sweep with absolute paths."""
    if isinstance(sweep.value, dict):
        return {
            name: [param_value(name, node) for node in entry.node.value]
            if isinstance(entry.node.value, list)
            else plain(entry.node)
            for name, entry in sweep.value.items()
        }
    return [{name: param_value(name, entry.node) for name, entry in row.value.items()} for row in sweep.value]


def _entry(step: Step) -> dict[str, Any]:
    """A stage with all its options; where a parameter was put in, its name stays, so that `-p` still works."""
    entry = step.entry
    result: dict[str, Any] = {"stage": plain(entry.stage, keep_params=True), "id": entry.id}
    if entry.sources is not None:
        result["from"] = plain(entry.sources, keep_params=True)
    if entry.recipes is not None:
        result["recipe"] = plain(entry.recipes, keep_params=True)
    for name, option in options_of(type(step.stage)).items():
        value = getattr(step.stage, name)
        written = entry.options.get(name)
        if written is not None and _has_param(written.node):
            result[name] = plain(written.node, keep_params=True)
        elif written is not None or (entry.stage.param is None and not (value is None and option.default is None)):
            # a stage chosen by a parameter keeps only what was written, as the defaults of another would not fit
            result[name] = plain_option(value)
    return result


def _has_param(node: Node) -> bool:
    if node.param is not None:
        return True
    if isinstance(node.value, list):
        return any(_has_param(item) for item in node.value)
    return isinstance(node.value, dict) and any(_has_param(entry.node) for entry in node.value.values())
