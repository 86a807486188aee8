"""Parameters: ``${name}``, overrides by ``-p name=value`` and ``-s stage.option=value``, and the rows of a sweep."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from sppm_pipeline.engine.config.configuration import RESERVED, Configuration, StageEntry, checked_seed
from sppm_pipeline.engine.config.document import (
    MAX_NODES,
    Entry,
    Node,
    Override,
    count_nodes,
    nodes_of,
    parse_yaml,
    plain,
)
from sppm_pipeline.engine.config.problems import Problems, raise_problems, shown
from sppm_pipeline.errors import ConfigError, Position, did_you_mean, listed

_WHOLE = re.compile(r"\$\{\s*(\w+)\s*\}")


MAX_ROWS = 100_000
"""Runs of a sweep."""


@dataclass(frozen=True)
class Overrides:
    """Changes that the command line makes in a configuration, as plain text."""

    params: tuple[str, ...] = ()  # "name=value"
    options: tuple[str, ...] = ()  # "stage.option=value"
    seed: int | None = None


def override_params(params: Mapping[str, Entry], overrides: Iterable[str]) -> tuple[dict[str, Entry], Problems]:
    """`params` with the values of the ``-p`` arguments."""
    result = dict(params)
    problems: Problems = []
    for argument in overrides:
        where = Override(f"-p {_short(argument)}")
        name, equals, text = argument.partition("=")
        if not equals:
            problems.append(ConfigError("expected name=value", where=where))
        elif name not in params:
            problems.append(_unknown(f"there is no parameter {shown(name)}", params, name, where))
        else:
            try:
                result[name] = Entry(where, parse_yaml(text, where))
            except ConfigError as error:
                problems.append(error)
    return result, problems


def _unknown(message: str, params: Mapping[str, Entry], name: str, where: Position) -> ConfigError:
    hint = did_you_mean(name, params) if params else "the configuration has no `params`"
    return ConfigError(message, where=where, hint=hint)


class Substituted(NamedTuple):
    """Lists of stages with parameters put in."""

    groups: dict[str, Node]
    used: set[str]  # parameters that were put in
    unread: set[Position]  # places of values that could not be read; further errors there would only be consequences


def put_in(groups: Mapping[str, Node], params: Mapping[str, Entry]) -> tuple[Substituted, Problems]:
    """Replace every ``${name}`` by the parameter's value, as long as the document does not become too large."""
    found = Substituted({}, set(), set())
    problems = [
        ConfigError(f"the parameter {name!r} can't refer to another one", where=node.where)
        for name, entry in params.items()
        for node in nodes_of(entry.node)
        if isinstance(node.value, str) and "${" in node.value
    ]
    count = 0

    def applied(node: Node) -> Node:
        nonlocal count
        if isinstance(node.value, list):
            return replace(node, value=[applied(item) for item in node.value])
        if isinstance(node.value, dict):
            return replace(node, value={k: Entry(e.where, applied(e.node)) for k, e in node.value.items()})
        if not isinstance(node.value, str) or "${" not in node.value:
            return node
        match = _WHOLE.fullmatch(node.value)
        if match is None or match[1] not in params:
            if node.where not in found.unread:
                found.unread.add(node.where)
                message = f"${{name}} stands for a whole value, got {shown(node.value)}"
                hint = "there is no text around a parameter; put the whole string into `params`"
                problems.append(
                    ConfigError(message, where=node.where, hint=hint)
                    if match is None
                    else _unknown(f"there is no parameter {match[1]!r}", params, match[1], node.where)
                )
            return node
        found.used.add(match[1])
        # counted before it is put in: the limit has to hold before the memory is taken
        value = params[match[1]].node
        before, count = count, count + count_nodes(value)
        if count > MAX_NODES:  # a long list put in many times would take more than the file's own values may
            found.unread.add(node.where)
            if before <= MAX_NODES:
                message = f"with parameters put in, the document has more than {MAX_NODES} values"
                problems.append(ConfigError(message, where=node.where))
            return node
        return Node(value.value, value.where, match[1])

    found.groups.update((name, applied(node)) for name, node in groups.items())
    return found, problems


def _short(argument: str) -> str:
    """An argument as messages show it: on one line, not longer than 80 characters."""
    line = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in argument[:81])
    return line if len(argument) <= 80 else f"{line[:77]}..."


def override_options(entries: Sequence[StageEntry], overrides: Iterable[str]) -> tuple[list[StageEntry], Problems]:
    """`entries`, of the pipeline and all recipes, with the values of the ``-s`` arguments."""
    result = list(entries)
    problems: Problems = []
    for argument in overrides:
        where = Override(f"-s {_short(argument)}")
        key, equals, text = argument.partition("=")
        target, dot, option = key.rpartition(".")
        found = _matching(result, target)
        hint = None
        if not equals or not dot or not target or not option:
            message = "expected stage.option=value, for instance sample.dart_throwing.count=60"
        elif option in RESERVED:
            message = f"`{option}` can't be set from the command line, only options can"
        elif len(found) > 1:
            message = f"{shown(target)} may mean {listed((result[i].address for i in found), 'or')}"
            hint = f"write for instance -s {result[found[0]].address}.{option}={text[:40]}"
        elif not found:
            message = f"there is no stage {shown(target)}"
            hint = did_you_mean(target, [entry.address for entry in result])
        else:
            try:
                result[found[0]] = result[found[0]].with_option(option, Entry(where, parse_yaml(text, where)))
            except ConfigError as error:
                problems.append(error)
            continue
        problems.append(ConfigError(message, where=where, hint=hint))
    return result, problems


def _matching(entries: Sequence[StageEntry], target: str) -> list[int]:
    """Indices of the entries that `target` names: by full address, else by id, by stage name, by a part of it."""

    def named(entry: StageEntry, word: str) -> tuple[bool, bool, bool]:
        return word == entry.id, word == entry.name, word in entry.name.split(".")

    # an exact address wins, however many entries a part of it would fit
    full = [i for i, entry in enumerate(entries) if target == entry.address]
    if full:
        return full
    recipe, _, rest = target.partition(".")
    inside = [i for i, entry in enumerate(entries) if entry.recipe == recipe]
    # the most exact kind of name that fits anything decides; looser ones would only add doubt
    for tier in range(3):
        found = [i for i, entry in enumerate(entries) if named(entry, target)[tier]]
        found = found or [i for i in inside if named(entries[i], rest)[tier]]
        if found:
            return found
    return []


def sweep_rows(sweep: Node, params: Mapping[str, Any]) -> list[dict[str, Entry]]:
    """The rows of a sweep: of a grid with its last parameter changing fastest, of a table as written.

    In a grid, ``{from: 1, to: 50}`` stands for the integers from 1 to 50, ``{from: 0, to: 100, step: 5}`` for every
    fifth. Raises `ConfigError` if a parameter is unknown, a list is empty, or there are too many rows.
    """
    problems: Problems = []
    rows: list[dict[str, Entry]] = []
    if isinstance(sweep.value, dict):
        axes = {name: _axis(entry) for name, entry in sweep.value.items()}
        for name, values in axes.items():
            if not values:
                message = f"the sweep of {name!r} must be a list of values, or integers such as {{from: 1, to: 50}}"
                problems.append(ConfigError(message, where=sweep.value[name].node.where))
        count = math.prod(len(axis) for axis in axes.values())
        if count > MAX_ROWS:
            raise ConfigError(f"the sweep has {count} runs; at most {MAX_ROWS} are allowed", where=sweep.where)
        rows = [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())] if axes else []
    else:
        for node in sweep.value:
            if isinstance(node.value, dict) and node.value:
                rows.append(dict(node.value))
            else:
                problems.append(ConfigError("a row of a sweep is a map of parameters to values", where=node.where))
    # `seed` varies like a parameter, though it stands for none
    names = [*params, "seed"]
    # rows of a grid share their nodes: each is checked once, not once a row
    entries = {(name, id(entry.node)): (name, entry) for row in rows for name, entry in row.items()}
    for name, entry in entries.values():
        if name not in names:
            message = f"the sweep varies {name!r}, which is no parameter"
            problems.append(ConfigError(message, where=entry.where, hint=did_you_mean(name, names)))
        elif name == "seed":
            try:
                checked_seed(plain(entry.node), entry.node.where)
            except ConfigError as error:
                problems.append(error)
    if not rows and not problems:
        problems.append(ConfigError("the sweep has no runs", where=sweep.where))
    raise_problems(problems)
    return rows


def _axis(entry: Entry) -> list[Entry]:
    """The values of one parameter of a grid; none if it is neither a list nor a range."""
    value, where = entry.node.value, entry.node.where
    if isinstance(value, list):
        return [Entry(entry.where, node) for node in value]
    if isinstance(value, dict):
        ends = {key: inner.node.value for key, inner in value.items()}
        whole = all(isinstance(end, int) and not isinstance(end, bool) for end in ends.values())
        if {"from", "to"} <= set(ends) <= {"from", "to", "step"} and whole:
            step = ends.get("step", 1)
            # before the range is written out, which a typing error would make as long as memory lasts
            if step > 0 and 0 <= ends["to"] - ends["from"] < MAX_ROWS * step:
                return [Entry(entry.where, Node(number, where)) for number in range(ends["from"], ends["to"] + 1, step)]
    return []


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
