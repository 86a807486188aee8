"""Presets: recipes that a configuration names, with parameters of their own put in."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from sppm_pipeline.engine.config.document import Entry, Node, as_node, plain
from sppm_pipeline.engine.config.problems import Problems, did_you_mean, shown
from sppm_pipeline.errors import ConfigError, Position
from sppm_pipeline.hookspecs import Preset

KEY = "preset"
"""Key of a recipe that is a preset and not a list of stages."""

_PARAM = re.compile(r"\$\{(\w+)\}")


def expanded(node: Node, presets: Mapping[str, Preset]) -> tuple[Node | None, Problems]:
    """The list of stages that a recipe of the form ``{preset: NAME, param: value, ...}`` means; others as they are.

    None if there is no preset of this name.
    """
    if not isinstance(node.value, dict) or KEY not in node.value:
        return node, []
    given = dict(node.value)
    named = given.pop(KEY).node
    if not isinstance(named.value, str) or named.value not in presets:
        hint = did_you_mean(str(named.value), presets)
        return None, [ConfigError(f"there is no preset {shown(plain(named))}", where=named.where, hint=hint)]
    preset = presets[named.value]
    problems: Problems = [
        ConfigError(
            f"the preset {named.value!r} has no parameter {shown(name)}",
            where=entry.where,
            hint=did_you_mean(name, preset.params),
        )
        for name, entry in given.items()
        if name not in preset.params
    ]
    return stages_of(preset, node.where, {name: entry.node for name, entry in given.items()}), problems


def stages_of(preset: Preset, where: Position, given: Mapping[str, Node] | None = None) -> Node:
    """The stages of a preset, all of them at `where`; a parameter that is None takes its option away."""
    values = {name: as_node(value, where) for name, value in preset.params.items()} | dict(given or {})

    def put_in(value: Any) -> Node:
        if isinstance(value, (list, tuple)):
            return Node([put_in(item) for item in value], where)
        if isinstance(value, Mapping):
            nodes = {key: put_in(item) for key, item in value.items()}
            # a parameter of None leaves the option to its default
            return Node({key: Entry(node.where, node) for key, node in nodes.items() if node.value is not None}, where)
        match = _PARAM.fullmatch(value) if isinstance(value, str) else None
        return values[match[1]] if match else Node(value, where)

    return put_in(preset.stages)
