"""From a configuration and overrides to a plan: parameters put in, options checked, stages wired, before any work."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from sppm_pipeline.engine.config.configuration import (
    FORMAT,
    Configuration,
    StageEntry,
    expanded,
    stage_entries,
    stages_of,
)
from sppm_pipeline.engine.config.document import Entry, Node, as_node, plain
from sppm_pipeline.engine.config.names import clashes
from sppm_pipeline.engine.config.options import (
    current_name,
    options_of,
    parse_options,
    plain_option,
    with_current_names,
)
from sppm_pipeline.engine.config.parameters import Overrides, override_options, override_params, put_in
from sppm_pipeline.engine.config.problems import Problems, raise_problems
from sppm_pipeline.engine.plan.plugins import Plugin
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.wiring import Draft, Step, Wired, recipe_names, recipe_order, wire
from sppm_pipeline.engine.process.containment import contained
from sppm_pipeline.errors import ConfigError, PluginError, Position, SppmError, described, did_you_mean

SWEEP_ID = "sweep"
"""Id under which the stages of `after` find the table of the sweep."""


@dataclass(frozen=True)
class Plan:
    """Everything that is known before the first stage runs."""

    configuration: Configuration
    name: str
    seed: int
    params: Mapping[str, Any]
    steps: tuple[Step, ...]
    recipes: Mapping[str, tuple[Step, ...]]
    after: tuple[Step, ...]  # stages that run once after a sweep
    warnings: tuple[str, ...]
    document: dict[str, Any] = field(repr=False)  # with overrides and defaults; run again, it gives the same
    plugins: tuple[Plugin, ...] = field(repr=False)  # all that were loaded

    def until(self, until: str | None) -> tuple[Step, ...]:
        """The steps of the pipeline up to the one of this id; all if it is None."""
        ids = [step.id for step in self.steps]
        if until is not None and until not in ids:
            raise ConfigError(f"--until: the pipeline has no stage {until!r}", hint=did_you_mean(until, ids))
        return self.steps if until is None else self.steps[: ids.index(until) + 1]


class Drafts(NamedTuple):
    """The stages of a configuration: parameters put in, stages looked up, options read; not wired yet."""

    configuration: Configuration
    registry: Registry
    seed: int
    params: Mapping[str, Entry]
    # of each recipe, the pipeline and `after`; None stands for a stage that is unknown
    groups: dict[str, list[Draft | None]]
    unread: set[Position]  # places of values that could not be read; further errors there would only be consequences
    renamed: tuple[str, ...]  # warnings of former names
    unused: tuple[str, ...]  # warnings of parameters that nothing refers to
    single: bool  # whether this is one row of a sweep


def make_plan(
    configuration: Configuration,
    registry: Registry,
    overrides: Overrides = Overrides(),  # noqa: B008 - frozen
    row: Mapping[str, Entry] | None = None,
    available: Mapping[str, tuple[type, ...]] | None = None,
    unread: Sequence[ConfigError] = (),
) -> Plan:
    """Read the stages, wire them, and raise all errors in one go, `unread` ones too; see `draft_plan`, `wire_plan`."""
    drafts, unfit = draft_plan(configuration, registry, overrides, row)
    plan, loose = wire_plan(drafts, available)
    raise_problems([*unread, *unfit, *loose])
    return plan


def draft_plan(
    configuration: Configuration, registry: Registry, overrides: Overrides, row: Mapping[str, Entry] | None = None
) -> tuple[Drafts, Problems]:
    """Put parameters and overrides in, look the stages up, and read their options; of a row of the sweep, the plan is
    that of a single run. `PluginError` if a stage breaks its contract.
    """
    params, problems = override_params(configuration.params, overrides.params)
    seed = configuration.seed if overrides.seed is None else overrides.seed
    if row is not None:
        params |= {name: entry for name, entry in row.items() if name != "seed"}
        seed = row["seed"].node.value if "seed" in row else seed
    lists: dict[str, Node] = {name: entry.node for name, entry in configuration.recipes.items()}
    lists[_PIPELINE] = configuration.pipeline
    if configuration.after is not None:
        lists[_AFTER] = configuration.after
    # before stages are looked up: a parameter may stand for the name of a stage
    put, unknown = put_in(lists, params)
    further: Problems = []
    groups: dict[str, list[StageEntry]] = {}
    for name, node in put.groups.items():
        stages, amiss = expanded(node, registry.presets)
        groups[name], wrong = (
            stage_entries(stages, None if name in (_PIPELINE, _AFTER) else name) if stages is not None else ([], [])
        )
        further += [*amiss, *wrong]
    # presets that are named without being written down become recipes
    for name, where in [use for group in groups.values() for entry in group for use in recipe_names(entry.recipes)]:
        if name not in groups and name in registry.presets:
            groups[name], wrong = stage_entries(stages_of(registry.presets[name], where), name)
            further += wrong
    # over all groups at once: whether a name is ambiguous depends on all of them
    flat, amiss = override_options([entry for group in groups.values() for entry in group], overrides.options)
    further += amiss
    changed = iter(flat)
    drafts: dict[str, list[Draft | None]] = {}
    renamed: dict[tuple[str, str], str] = {}
    for name, group in groups.items():
        drafts[name] = []
        for _ in group:
            draft, wrong = _draft(next(changed), configuration, registry, renamed)
            drafts[name].append(draft)
            further += wrong
    unused = tuple(
        f"{entry.where}: the parameter {name!r} is not used" for name, entry in params.items() if name not in put.used
    )
    found = Drafts(
        configuration, registry, seed, params, drafts, put.unread, tuple(renamed.values()), unused, row is not None
    )
    return found, [*problems, *unknown, *(one for one in further if one.where not in put.unread)]


def wire_plan(drafts: Drafts, available: Mapping[str, tuple[type, ...]] | None = None) -> tuple[Plan, Problems]:
    """Wire recipes, pipeline and `after`; the plan is complete if neither the drafts nor the wiring are wrong.
    `available` are artifact types, by id, that are there before the first stage.
    """
    configuration, groups = drafts.configuration, drafts.groups
    recipes: dict[str, Wired] = {name: Wired((), None) for name in groups if name not in (_PIPELINE, _AFTER)}
    written = {name: [draft.entry for draft in group if draft is not None] for name, group in groups.items()}
    measured = {
        name
        for group in groups.values()
        for draft in group
        if draft is not None and draft.cls.returns is not None
        for name, _ in recipe_names(draft.entry.recipes)
    }
    order, problems = recipe_order({name: groups[name] for name in recipes})
    for name in order:
        recipes[name], loose = wire(groups[name], recipes)
        problems += loose
        if recipes[name].makes == () and written[name] and name not in measured:
            message = f"the recipe {name!r} ends in a stage that makes nothing"
            problems.append(ConfigError(message, where=written[name][-1].where))
    pipeline, loose = wire(groups[_PIPELINE], recipes, available)
    problems += loose
    after = Wired((), None)
    if configuration.after is not None:
        table: type = importlib.import_module("sppm_pipeline.nouns.table").Table  # late, as artifacts import numpy
        after, loose = wire(groups[_AFTER], recipes, {SWEEP_ID: (table,)})
        problems += loose
    inner = {name: wired.steps for name, wired in recipes.items()}
    in_run = [*pipeline.steps, *(step for steps in inner.values() for step in steps)]
    # apart: the stages of `after` write beside the folders of the runs
    problems += [*clashes(_claims(in_run)), *clashes(_claims(after.steps))]
    warnings = [*drafts.renamed, *drafts.unused]
    everything = [step for steps in (pipeline.steps, after.steps, *inner.values()) for step in steps]
    # where a parameter says which recipe a stage is handed, the others are there to be chosen
    if not any(step.entry.recipes is not None and step.entry.recipes.has_param for step in everything):
        used = {name for step in everything for name in step.recipes.values()}
        warnings += [
            f"{entry.where}: the recipe {name!r} is not used"
            for name, entry in configuration.recipes.items()
            if name not in used
        ]
    plan = Plan(
        configuration=configuration,
        name=configuration.name,
        seed=drafts.seed,
        params={name: plain(entry.node) for name, entry in drafts.params.items()},
        steps=pipeline.steps,
        recipes=inner,
        after=after.steps,
        warnings=tuple(warnings),
        document=_document(drafts, pipeline.steps, inner, after.steps),
        plugins=tuple(drafts.registry.plugins.plugins),
    )
    return plan, [one for one in problems if one.where not in drafts.unread]


def _claims(steps: Iterable[Step]) -> list[tuple[str, str, Position]]:
    """The outputs that options name: stage, name, place."""
    claims = []
    for step in steps:
        for name, option in options_of(type(step.stage)).items():
            value = getattr(step.stage, name)
            if option.spec.output and value is not None:
                written = step.entry.options.get(name)
                claims.append((step.address, value, written.node.where if written else step.where))
    return claims


_PIPELINE = ""
_AFTER = "after:"  # no recipe can have these names


def _draft(
    entry: StageEntry, configuration: Configuration, registry: Registry, renamed: dict[tuple[str, str], str]
) -> tuple[Draft | None, Problems]:
    """Look a stage up and read its options; former names that are used go to `renamed`, each once."""
    try:
        cls = registry.get(entry.name, entry.stage.where)
        owner, alias = registry.owner(entry.name), registry.aliases.get(entry.name)
    except ConfigError as error:
        return None, [error]
    except PluginError as error:
        error.where = error.where or entry.where
        raise
    (options, former), problems = with_current_names(cls, entry.options, stage=entry.address)
    for name in former:
        renamed.setdefault(
            (cls.name, name),
            f"{entry.options[name].where}: the option {name!r} of {cls.name} is now "
            f"{current_name(cls, name)!r}; the old name works in this version",
        )

    def locate(error: SppmError) -> None:
        error.where, error.stage = error.where or entry.where, error.stage or entry.address

    def fault(message: str) -> SppmError:
        return PluginError(f"{owner}: checking the options {message}", where=entry.where, stage=entry.address)

    if alias is not None:
        message = f"{entry.stage.where}: stage {entry.name!r} is now {cls.name!r}; the old name works in this version"
        renamed.setdefault((entry.name, ""), message)
        given = {name: plain(one.node) for name, one in options.items()}
        try:
            implied = alias.options(given) if callable(alias.options) else alias.options
        except ConfigError as error:
            locate(error)
            problems.append(error)
            implied = {}
        for name, value in implied.items():
            options.setdefault(name, Entry(entry.where, as_node(plain_option(value), entry.where)))
    entry = dataclasses.replace(entry, options=options, stage=dataclasses.replace(entry.stage, value=cls.name))
    values, unfit = parse_options(cls, options, entry.where, configuration.base_of, stage=entry.address)
    problems += unfit
    stage = None
    if not unfit:
        try:
            with nullcontext() if owner.builtin else contained(fault):
                stage = cls(**values)
                stage.check_options()
        except ConfigError as error:
            locate(error)
            problems.append(error)
            stage = None
        except SppmError as error:
            locate(error)
            raise
        except Exception as error:
            raise fault(f"raised {described(error)}") from error
    return Draft(entry, cls, stage, owner), problems


def step_options(step: Step) -> dict[str, Any]:
    """All options of a step, defaults included, JSON-ready."""
    return {name: plain_option(getattr(step.stage, name)) for name in options_of(type(step.stage))}


def _document(
    drafts: Drafts, steps: Sequence[Step], recipes: Mapping[str, Sequence[Step]], after: Sequence[Step]
) -> dict[str, Any]:
    """The configuration as a run record keeps it."""
    configuration = drafts.configuration
    # paths are written absolute, so that the record can be run from another folder
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
        "seed": drafts.seed,
        "folder": str(configuration.folder),
    }
    if configuration.audit != "fail":
        document["audit"] = configuration.audit
    if drafts.params:
        document["params"] = {name: param_value(name, entry.node) for name, entry in drafts.params.items()}
    if configuration.plugins:
        document["plugins"] = [str(path.absolute()) for path in configuration.plugins]
    if recipes:
        document["recipes"] = {name: [_entry(step) for step in steps] for name, steps in recipes.items()}
    document["pipeline"] = [_entry(step) for step in steps]
    if configuration.sweep is not None and not drafts.single:
        document["sweep"] = _sweep(configuration.sweep, param_value)
        if after:
            document["after"] = [_entry(step) for step in after]
    return document


def _sweep(sweep: Node, param_value: Any) -> Any:
    """The sweep with absolute paths; what is no row is left as it is, for `sweep_rows` to refuse."""
    if isinstance(sweep.value, dict):
        return {
            name: [param_value(name, node) for node in entry.node.value]
            if isinstance(entry.node.value, list)
            else plain(entry.node)
            for name, entry in sweep.value.items()
        }
    return [
        {name: param_value(name, entry.node) for name, entry in row.value.items()}
        if isinstance(row.value, dict)
        else plain(row)
        for row in sweep.value
    ]


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
        if written is not None and written.node.has_param:
            result[name] = plain(written.node, keep_params=True)
        elif written is not None or (entry.stage.param is None and not (value is None and option.default is None)):
            # a stage chosen by a parameter keeps only what was written, as the defaults of another would not fit
            result[name] = plain_option(value)
    return result
