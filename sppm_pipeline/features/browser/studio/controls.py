"""Controls of the studio: values of a configuration that may be changed, from the declarations of options."""

from __future__ import annotations

import json
import math
import re
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sppm_pipeline.engine.config.configuration import KEY as PRESET
from sppm_pipeline.engine.config.configuration import MAX_SEED
from sppm_pipeline.engine.config.document import Node, parse_yaml
from sppm_pipeline.engine.config.options import Option, allowed_words, options_of, plain_option
from sppm_pipeline.engine.plan.planning import Plan
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.engine.plan.wiring import Step
from sppm_pipeline.errors import ConfigError, Position
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.stage import OptionSpec

_ANCHOR = re.compile(r"&\S+\s*")

KEYS = ("stage", "preset", "sppm")
"""Keys behind which new ones are written: a stage, a preset and a configuration have one of these."""


@dataclass(frozen=True)
class Place:
    """Place of a value in a text."""

    start: int  # characters
    end: int
    line: int  # counted from 1, as positions of the engine are
    column: int
    items: tuple[str, ...] | None  # keys of the items of a list
    flow: bool  # the map around it is written in braces
    quoted: bool  # the key in front of it is in quotes
    indent: int  # column of that key, counted from 0


def places(text: str) -> dict[str, Place]:
    """The place of every value by its path, ``recipes.cell.0.total``; the text must be one that the engine reads."""
    from ruamel.yaml import YAML

    found: dict[str, Place] = {}
    seen: set[int] = set()

    def visit(path: str, node: Any, flow: bool, quoted: bool, indent: int) -> None:
        if id(node) in seen:  # an alias is a place already: that of its anchor
            return
        seen.add(id(node))
        listed = isinstance(node.value, list)
        mapping = listed and type(node).__name__ == "MappingNode"
        inner = [f"{path}.{i}" if path else str(i) for i in range(len(node.value))] if listed and not mapping else None
        start, end = node.start_mark, node.end_mark
        items = None if inner is None else tuple(inner)
        anchor = _ANCHOR.match(text, start.index)  # stays in front of the value
        begin = anchor.end() if anchor else start.index
        found[path] = Place(begin, end.index, start.line + 1, start.column + 1, items, flow, quoted, indent)
        if mapping:
            for key, value in node.value:
                under = f"{path}.{key.value}" if path else str(key.value)
                visit(under, value, bool(node.flow_style), bool(key.style), key.start_mark.column)
                if under in found and found[under].start == found[under].end:  # of nothing: the mark of what follows it
                    after = text.index(":", key.end_mark.index) + 1
                    found[under] = replace(found[under], start=after, end=after)
        elif inner is not None:
            for name, value in zip(inner, node.value, strict=True):
                visit(name, value, True, False, 0)

    visit("", YAML(typ="safe", pure=True).compose(text), True, False, 0)
    return found


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """The text with other values (bool, int, float, str, None, or list of them) by their paths.

    A path that is not there yet is written behind the key of its map that is one of `KEYS`; `ConfigError` if there is
    no place for it.
    """
    known = places(text)
    edits: list[tuple[int, int, str]] = []
    for path, value in values.items():
        place = known.get(path)
        if place is None:
            edits.append(_insertion(text, known, path, value))
        elif isinstance(value, list) and place.items is not None and len(place.items) == len(value):
            edits += [_replacement(text, known[item], each) for item, each in zip(place.items, value, strict=True)]
        else:
            edits.append(_replacement(text, place, value))
    edits.reverse()  # of those at one place the last goes in first, so that they stand in their order
    # from the end of the text, so that earlier places stay where they are
    for start, end, words in sorted(edits, key=lambda edit: edit[:2], reverse=True):
        text = text[:start] + words + text[end:]
    return text


def _replacement(text: str, place: Place, value: Any) -> tuple[int, int, str]:
    quoted = text[place.start : place.start + 1] == '"'
    return place.start, place.end, (" " if place.start == place.end else "") + _word(value, quoted)


def _insertion(text: str, known: Mapping[str, Place], path: str, value: Any) -> tuple[int, int, str]:
    parent, _, name = path.rpartition(".")
    anchors = [known[key] for word in KEYS if (key := f"{parent}.{word}" if parent else word) in known]
    if not anchors:
        raise ConfigError(f"there is no place for {path!r} in the configuration")
    anchor = anchors[0]
    word = f"{json.dumps(name) if anchor.quoted else name}: {_word(value, anchor.quoted)}"
    if anchor.flow:
        return anchor.end, anchor.end, f", {word}"
    ends = text.find("\n", anchor.end)
    line = " " * anchor.indent + word
    if ends < 0:
        return len(text), len(text), f"\n{line}"
    return ends + 1, ends + 1, line + ("\r\n" if text[ends - 1] == "\r" else "\n")


def _word(value: Any, quoted: bool = False) -> str:
    """A value as YAML: in quotes if it was, as in JSON, or if it would mean something else without."""
    if isinstance(value, list):
        return f"[{', '.join(_word(item, quoted) for item in value)}]"
    if isinstance(value, str) and not quoted:
        # without quotes only if the engine reads the same string from it
        plain = value.isascii() and value.replace("_", "").replace(" ", "").replace(".", "").isalnum()
        if plain and value == value.strip() and parse_yaml(value, Position("", 0, 0)).value == value:
            return value
    try:
        return json.dumps(value, ensure_ascii=False, allow_nan=False)
    except ValueError:
        raise ConfigError(f"numbers in a configuration are finite, got {value!r}") from None


SPAN = 4
"""A slider without near bounds goes from this fraction of a value to this multiple. Not sensitive: any number can be
typed."""

INSTANT = ("pore_radius", "tunnel_radius", "omega", "mu", "level")
"""Options of `field.gaussian` that the browser shows at once, before the cell is drawn again."""


@dataclass(frozen=True)
class Control:
    """Something that may be changed."""

    key: str  # its path in the text; see `places`
    group: str  # the stage that it belongs to, as messages call it
    label: str
    help: str
    unit: str
    allowed: str
    kind: str  # "number", "integer", "length", "choice" or "flag"
    value: Any  # as YAML has it; None if it is left out, a list if it is one
    choices: tuple[str, ...] = ()
    slider: tuple[float, float, float] | None = None  # low, high, step; None without a value to go out from
    written: bool = True  # it stands in the file; the page shows these first
    optional: bool = False  # it may be left out
    instant: str = ""  # which of `INSTANT` it is; empty for others
    role: str = ""  # stage and option, by which the page knows those of a part


def controls_of(plan: Plan, steps: Sequence[Step], registry: Registry, known: Mapping[str, Place]) -> list[Control]:
    """The controls of these steps, in order: the seed, and what is written of each stage before what is left out."""
    at = {(place.line, place.column): key for key, place in reversed(tuple(known.items()))}
    seed = OptionSpec("integer from which all random numbers are drawn", minimum=0, maximum=MAX_SEED)
    made = {
        "seed": Control("seed", "", "seed", seed.help, "", allowed_words(Option("seed", int, seed, 0)), "integer",
                        plan.seed, slider=(0, max(100, plan.seed), 1))
    }  # fmt: skip
    for step in steps:
        place = at.get((step.where.line, step.where.column), "")
        if place.endswith(".stage"):
            found = _of_stage(step, place.removesuffix("stage"), at)
        elif f"{place}.{PRESET}" in known:
            found = _of_preset(plan, step.entry.recipe or "", f"{place}.", registry)
        else:
            continue  # a preset that is named, and not written down
        for control in found:
            # options whose value is a parameter change the parameter, once for all stages that use it
            made.setdefault(control.key, control)
    return list(made.values())


def _of_stage(step: Step, place: str, at: Mapping[tuple[int, int], str]) -> Iterator[Control]:
    declared = options_of(type(step.stage))
    for name in sorted(declared, key=lambda name: name not in step.entry.options):
        written = step.entry.options.get(name)
        if written is not None and isinstance(written.node.value, list) and any(n.param for n in written.node.value):
            continue
        key, label = f"{place}{name}", name
        if written is not None:
            where = written.node.where
            if (where.line, where.column) not in at:
                continue
            key = at[where.line, where.column]
            label = written.node.param or name
        role = f"{step.stage.name}.{name}"
        value = plain_option(getattr(step.stage, name))
        yield from _control(declared[name], key, step.address, label, value, written is not None, role)


def _of_preset(plan: Plan, recipe: str, place: str, registry: Registry) -> Iterator[Control]:
    """The parameters of a preset, each declared as the first option that it stands for."""
    node = plan.configuration.recipes[recipe].node.value
    preset = registry.presets[node[PRESET].node.value]
    for entry in preset.stages:
        for name, option in options_of(registry.get(str(entry["stage"]))).items():
            value = entry.get(name)
            param = value[2:-1] if isinstance(value, str) and value.startswith("${") else None
            if param is None or (param in node and node[param].node.param is not None):
                continue
            written = param in node
            current = node[param].node.value if written else preset.params[param]
            if isinstance(current, list):
                current = [item.value if isinstance(item, Node) else item for item in current]
            role = f"{entry['stage']}.{name}"
            yield from _control(option, f"{place}{param}", recipe, param, current, written, role)


def _control(
    option: Option, key: str, group: str, label: str, value: Any, written: bool, role: str
) -> Iterator[Control]:
    """The control of an option, if it is of a kind that a slider, a box or a list of words can change."""
    spec = option.spec
    stage, _, name = role.rpartition(".")
    instant = name if stage == "field.gaussian" and name in INSTANT else ""
    members = typing.get_args(option.kind) if isinstance(option.kind, types.UnionType) else (option.kind,)
    kinds = [member for member in members if member is not types.NoneType]
    parts = typing.get_args(kinds[0]) if typing.get_origin(kinds[0]) is tuple else ()
    if parts and (not isinstance(value, (list, tuple)) or Ellipsis in parts):
        return
    kind = _kind(parts or tuple(kinds), spec, value)
    if kind is None or spec.output or spec.column:
        return
    listed = list(value) if isinstance(value, (list, tuple)) else value
    numbers = [number for v in (listed if isinstance(listed, list) else [listed]) if (number := _number(v)) is not None]
    slider = _slider(spec, numbers, kind == "integer") if numbers and kind not in ("choice", "flag") else None
    yield Control(
        key, group, label, spec.help, spec.unit or "", allowed_words(option), kind, listed, spec.choices, slider,
        written, types.NoneType in members or not option.required, instant, role,
    )  # fmt: skip


def _kind(kinds: tuple[Any, ...], spec: OptionSpec, value: Any) -> str | None:
    if Length in kinds:
        return "length"
    if float in kinds or int in kinds:
        return None if isinstance(value, str) else "number" if float in kinds else "integer"
    if bool in kinds:
        return "flag"
    return "choice" if spec.choices else None


def _number(value: Any) -> float | None:
    """The number of a value, without its unit; None if it has none, or an infinite one."""
    if isinstance(value, bool) or value is None:
        return None
    try:
        number = float(value.split()[0] if isinstance(value, str) and value else value)
    except ValueError:
        return None
    return number if math.isfinite(number) else None


def _slider(spec: OptionSpec, numbers: Sequence[float], whole: bool) -> tuple[float, float, float]:
    """From where to where a slider goes, and its step: the declared bounds where they are near the value."""
    least = spec.minimum if spec.minimum is not None else spec.above
    most = spec.maximum if spec.maximum is not None else spec.below
    size = max(map(abs, numbers)) or 1.0
    low = -SPAN * size if min(numbers) < 0 else min(numbers) / SPAN
    high = SPAN * size
    if most is not None and most <= 2 * SPAN * size:
        high = most
        low = least if least is not None and least >= 0 else low
    low, high = max(low, -math.inf if least is None else least), min(high, math.inf if most is None else most)
    power = 0 if whole else math.floor(math.log10((high - low or size) / 50))
    step = float(f"1e{power}")
    low, high = round(step * math.ceil(low / step - 1e-9), -power), round(step * math.floor(high / step + 1e-9), -power)
    # exclusive bounds are no values
    if low == spec.above:
        low = round(low + step, -power)
    if high == spec.below:
        high = round(high - step, -power)
    # values stay as they are, if between steps or beside a bound
    return min(low, min(numbers)), max(high, max(numbers)), step
