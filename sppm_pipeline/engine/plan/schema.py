"""The JSON Schema of configurations, for editors: every stage with its options, units and bounds."""

from __future__ import annotations

import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from sppm_pipeline.engine.config.configuration import AUDITS, FORMAT, KEY, KEYS
from sppm_pipeline.engine.config.options import Option, options_of, plain_option
from sppm_pipeline.engine.plan.describe import purpose_of
from sppm_pipeline.engine.plan.ports import signature_of
from sppm_pipeline.engine.plan.registry import Registry
from sppm_pipeline.nouns.length import CELL_UNIT, UNITS_IN_MM, Length
from sppm_pipeline.stage import OptionSpec, Stage, StageAlias

_NUMBER = r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?"
_PARAM = {"type": "string", "pattern": r"^\$\{\s*\w+\s*\}$"}


def configuration_schema(registry: Registry) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a configuration with the stages of `registry`."""
    entry = {"$ref": "#/$defs/stage"}
    stages = {"type": "array", "minItems": 1, "items": entry}
    whole = {"type": "integer"}
    whole_range = {
        "type": "object",
        "required": ["from", "to"],
        "properties": {"from": whole, "to": whole, "step": {"type": "integer", "minimum": 1}},
        "additionalProperties": False,
    }
    top: dict[str, Any] = {
        "sppm": {"const": FORMAT},
        "name": {"type": "string", "pattern": r"^\w[\w .+-]{0,99}$"},
        "seed": {"type": "integer", "minimum": 0},
        "params": {"type": ["object", "null"]},
        "plugins": {"type": ["array", "null"], "items": {"type": "string"}},
        "recipes": {"type": ["object", "null"], "additionalProperties": {"anyOf": [stages, *_presets(registry)]}},
        "pipeline": stages,
        "sweep": {
            "anyOf": [
                {"type": "object", "additionalProperties": {"anyOf": [{"type": "array", "minItems": 1}, whole_range]}},
                {"type": "array", "minItems": 1, "items": {"type": "object"}},
            ]
        },
        "after": stages,
        "audit": {"enum": list(AUDITS)},
        "folder": {"type": "string"},
        "notes": {"type": ["object", "null"]},
    }
    names = list(registry.sound())
    classes = [registry.get(name) for name in names]
    named: dict[str, Any] = {"type": "object", "required": ["stage"]}
    former = {name: alias for name, alias in sorted(registry.aliases.items()) if alias.name in names}
    choices: list[dict[str, Any]] = [{"enum": names}]
    if former:
        choices.append({"enum": list(former), "deprecated": True})
    named["properties"] = {"stage": {"anyOf": [*choices, _PARAM]}}
    named["allOf"] = [
        {"if": {"properties": {"stage": {"const": name}}}, "then": {"$ref": f"#/$defs/{name}"}}
        for name in (*names, *former)
    ]
    definitions: dict[str, Any] = {cls.name: _stage_schema(cls) for cls in classes}
    definitions |= {name: _alias_schema(registry.get(name), name, alias) for name, alias in former.items()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "sppm pipeline",
        "type": "object",
        "required": ["sppm", "pipeline"],
        "additionalProperties": False,
        "properties": {key: {"description": KEYS[key], **top[key]} for key in KEYS},
        "$defs": {"stage": {"anyOf": [*choices, named]}} | definitions,
    }


def _presets(registry: Registry) -> Iterator[dict[str, Any]]:
    """Recipes of the form ``{preset: NAME, ...}``."""
    for name, preset in sorted(registry.presets.items()):
        properties = {KEY: {"const": name, "description": preset.help}} | {
            param: {"default": default} for param, default in preset.params.items()
        }
        yield {"type": "object", "required": [KEY], "additionalProperties": False, "properties": properties}


def _stage_schema(cls: type[Stage]) -> dict[str, Any]:
    """The schema of one stage's entry."""
    ports = signature_of(cls).ports
    text = {"type": "string"}
    text_or_map = {"anyOf": [text, {"type": "object", "additionalProperties": text}]}
    ids = {"anyOf": [text, {"type": "array", "items": text, "minItems": 1}]}
    properties: dict[str, Any] = {
        "stage": {"const": cls.name, "description": purpose_of(cls)},
        "id": {"type": "string", "pattern": r"^\w[\w.#-]*$"},
    }
    if any(not port.is_recipe for port in ports):
        properties["from"] = {"anyOf": [*ids["anyOf"], {"type": "object", "additionalProperties": ids}]}
    if any(port.is_recipe for port in ports):
        properties["recipe"] = text_or_map
    either: list[dict[str, Any]] = []
    required = ["stage"] + ["recipe"] * any(port.is_recipe and not port.optional for port in ports)
    for option in options_of(cls).values():
        properties[option.name] = _option_schema(option)
        if option.spec.formerly is not None:
            properties[option.spec.formerly] = _option_schema(option) | {"deprecated": True}
            if option.required:
                either.append({"anyOf": [{"required": [name]} for name in (option.name, option.spec.formerly)]})
        elif option.required:
            required.append(option.name)
    schema = {"type": "object", "required": required, "additionalProperties": False, "properties": properties}
    return schema | {"allOf": either} if either else schema


def _alias_schema(cls: type[Stage], name: str, alias: StageAlias) -> dict[str, Any]:
    """The schema of an entry that names a stage by a former name; what that name implied need not be written."""
    schema = _stage_schema(cls)
    schema["properties"]["stage"] = {"const": name, "description": f"now {cls.name}", "deprecated": True}
    implied = {option.name for option in options_of(cls).values()} if callable(alias.options) else set(alias.options)
    schema["required"] = [key for key in schema["required"] if key not in implied]
    return schema | {"deprecated": True}


def _option_schema(option: Option) -> dict[str, Any]:
    unit = f" [{option.spec.unit}]" if option.spec.unit else ""
    schema: dict[str, Any] = {"description": option.spec.help + unit}
    if not option.required:
        schema["default"] = plain_option(option.default)
    return schema | {"anyOf": [*_kinds(option.kind, option.spec), _PARAM]}


def _kinds(kind: Any, spec: OptionSpec) -> list[dict[str, Any]]:
    """Alternatives that a type form allows."""
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return [schema for member in typing.get_args(kind) for schema in _kinds(member, spec)]
    if typing.get_origin(kind) is tuple:
        elements = typing.get_args(kind)
        if len(elements) == 2 and elements[1] is Ellipsis:
            return [{"type": "array", "items": _element(elements[0], spec)}]
        items = [_element(element, spec) for element in elements]
        return [{"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}]
    bounds = {
        key: value
        for key, value in (
            ("minimum", spec.minimum),
            ("maximum", spec.maximum),
            ("exclusiveMinimum", spec.above),
            ("exclusiveMaximum", spec.below),
        )
        if value is not None
    }
    if kind is Length:
        units = "|".join((*UNITS_IN_MM, CELL_UNIT) if spec.unit == "cell size" else UNITS_IN_MM)
        return [{"type": "number", **bounds}, {"type": "string", "pattern": rf"^\s*{_NUMBER}\s*({units})?\s*$"}]
    if kind in (int, float):
        return [{"type": "integer" if kind is int else "number", **bounds}]
    if kind is bool:
        return [{"type": "boolean"}]
    if kind is types.NoneType:
        return [{"type": "null"}]
    if kind is not Path and spec.choices:
        return [{"enum": list(spec.choices)}]
    if spec.suffixes and "/" not in spec.suffixes:
        return [{"type": "string", "pattern": f"({'|'.join(map(_any_case, spec.suffixes))})$"}]
    return [{"type": "string"}]


def _any_case(suffix: str) -> str:
    """A pattern of a suffix in any case; patterns of JSON Schema have no flags."""
    return "".join(f"[{c}{c.upper()}]" if c.isalpha() else f"[{c}]" for c in suffix)


def _element(kind: Any, spec: OptionSpec) -> dict[str, Any]:
    kinds = _kinds(kind, spec)
    return kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
