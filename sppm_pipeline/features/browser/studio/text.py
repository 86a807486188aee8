"""Values put into the text of a configuration, of which all else stays as it was written, comments and all."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from sppm_pipeline.engine.config.document import parse_yaml
from sppm_pipeline.errors import ConfigError, Position

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
