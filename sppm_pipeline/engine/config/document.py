"""YAML text as a tree of plain values in which every key and every value knows its line and column.

The tree is composed here from the parser's events, one by one, so that a document that would explode (deep nesting,
aliases of aliases, merge keys of merge keys) is refused at the event where it passes a limit. Scalars follow the core
schema of YAML 1.2: ``1e-3`` is a number, ``no`` is a string.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from sppm_pipeline.engine.config.limits import (
    MAX_DEPTH,
    MAX_DIGITS,
    MAX_KEY,
    MAX_NODES,
    MAX_RECORD,
    MAX_SCALAR,
    decoded,
    parsable,
    refuse_unparsed,
    unprintable,
)
from sppm_pipeline.errors import ConfigError, Position, ResourceError
from sppm_pipeline.nouns.length import Length

RECORD_KEY = "sppm_run"
"""First key of a run record; its `config`, which comes next, is then the document, and the rest is not read."""

DECIMALS = "decimals are written with a point: 0.05, not 0,05"
"""Hint for a comma in a number."""

_INT = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_SPECIAL: dict[str, Any] = (
    dict.fromkeys(["", "~", "null", "Null", "NULL"])
    | dict.fromkeys(["true", "True", "TRUE"], True)
    | dict.fromkeys(["false", "False", "FALSE"], False)
    | {sign + word: float(sign + "inf") for sign in ("", "+", "-") for word in (".inf", ".Inf", ".INF")}
    | dict.fromkeys([".nan", ".NaN", ".NAN"], float("nan"))
)


class Override(Position):
    """A place on the command line, for instance ``-p porosity=0.6``."""

    def __init__(self, argument: str) -> None:
        super().__init__(argument, 0, 0)


@dataclass(frozen=True, slots=True)
class Node:
    """A value of the document."""

    value: Any  # None, bool, int, float, str, list of Node, or dict of str to Entry
    where: Position
    param: str | None = None  # the parameter whose value stands here

    @property
    def has_param(self) -> bool:
        """True if a parameter's value stands anywhere in it."""
        return any(node.param is not None for node in nodes_of(self))


class Entry(NamedTuple):
    """A key's place and its value."""

    where: Position
    node: Node


def read_yaml(path: Path) -> Node:
    """The tree of a configuration file, or of the configuration inside a run record; see `yaml_text` for errors."""
    return parse_yaml(yaml_text(path), str(path))


def yaml_text(path: Path) -> str:
    """The text of a configuration file, or of the run record in which the configuration is.

    Raises `ConfigError` if there is no such file, it is no UTF-8 or it is too large, `ResourceError` if it can't be
    read.
    """
    try:
        # opening a pipe would wait for a writer for ever
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ConfigError(f"{str(path)!r} is a pipe or a device, not a configuration file")
        with path.open("rb") as file:
            data = file.read(MAX_RECORD + 1)
    except (FileNotFoundError, NotADirectoryError):
        raise ConfigError(f"there is no file {str(path)!r}") from None
    except IsADirectoryError:
        raise ConfigError(f"{str(path)!r} is a folder, not a configuration file") from None
    except OSError as error:
        raise ResourceError(f"can't read {str(path)!r}: {error.strerror}") from error
    # in a record only the configuration counts, which comes first
    is_record = data.lstrip()[:200].startswith(b"{") and f'"{RECORD_KEY}"'.encode() in data[:200]
    text = decoded(data, str(path), is_record=is_record)
    return parsable(text) if is_record else text


def parse_yaml(text: str, file: str) -> Node:
    """The tree of the only document in `text`; `file` is the name that positions show."""
    refuse_unparsed(text, file)
    return _Composer(text, file, None).document()


def parse_value(text: str, where: Position) -> Node:
    """A value given on the command line, read as YAML; all of it lies at `where`."""
    refuse_unparsed(text, where.file, where)
    return _Composer(text, where.file, where).document()


def as_node(value: Any, where: Position) -> Node:
    """A plain Python value as a tree whose every part lies at `where`."""
    if isinstance(value, (list, tuple)):
        return Node([as_node(item, where) for item in value], where)
    if isinstance(value, dict):
        return Node({str(key): Entry(where, as_node(item, where)) for key, item in value.items()}, where)
    return Node(value, where)


def compose(value: Mapping[str, Any], name: str) -> Node:
    """Plain Python values as the tree of a document, under the same limits as a file.

    Allowed are None, bool, int, float, str, `pathlib.Path`, `Length`, numpy scalars, lists, tuples and mappings.
    Positions show `name` with the path to the value: ``name: pipeline[2].count``.
    """
    node = _composed(value, name, "", 0)
    if count_nodes(node) > MAX_NODES:
        raise ConfigError(f"the document has more than {MAX_NODES} values", where=node.where)
    return node


def _composed(value: Any, name: str, path: str, depth: int) -> Node:
    where = Position(f"{name}: {path}" if path else name, 0, 0)
    if depth > MAX_DEPTH:
        raise ConfigError(f"nested deeper than {MAX_DEPTH} levels", where=where)
    if isinstance(value, Mapping):
        entries = {}
        for key, item in value.items():
            if not isinstance(key, str):
                raise ConfigError(f"keys must be strings, got {_shown(key)}", where=where)
            node = _composed(item, name, f"{path}.{key}" if path else key, depth + 1)
            entries[key] = Entry(node.where, node)
        return Node(entries, where)
    if isinstance(value, (list, tuple)):
        return Node([_composed(item, name, f"{path}[{i}]", depth + 1) for i, item in enumerate(value)], where)
    if isinstance(value, Length):
        value = f"{value.value!r} {value.unit}" if value.unit else value.value
    elif isinstance(value, PurePath):
        value = str(value)
    elif hasattr(value, "tolist"):  # numpy's scalars and arrays
        return _composed(value.tolist(), name, path, depth)
    if isinstance(value, str):
        if len(value) > MAX_SCALAR:
            raise ConfigError(f"the string {value[:20]!r}... is longer than {MAX_SCALAR} characters", where=where)
        if (bad := unprintable(value)) is not None:
            raise ConfigError(f"the character {bad} is not allowed in a string", where=where)
    elif value is not None and not isinstance(value, (bool, int, float)):
        raise ConfigError(f"a configuration can't hold {type(value).__name__}: {value!r:.60}", where=where)
    return Node(value, where)


def plain(node: Node, *, keep_params: bool = False) -> Any:
    """The value as plain Python; with `keep_params`, ``${name}`` where a parameter's value stands."""
    if keep_params and node.param is not None:
        return f"${{{node.param}}}"
    if isinstance(node.value, list):
        return [plain(item, keep_params=keep_params) for item in node.value]
    if isinstance(node.value, dict):
        return {key: plain(entry.node, keep_params=keep_params) for key, entry in node.value.items()}
    return node.value


def nodes_of(node: Node) -> Iterator[Node]:
    """All values of a tree, the root included."""
    yield node
    values = node.value if isinstance(node.value, list) else ()
    for inner in [entry.node for entry in node.value.values()] if isinstance(node.value, dict) else values:
        yield from nodes_of(inner)


def count_nodes(node: Node) -> int:
    """Values in a tree, the root and keys included."""
    return sum(1 + (len(inner.value) if isinstance(inner.value, dict) else 0) for inner in nodes_of(node))


def _hint(text: str, problem: str, number: int) -> str | None:
    """Hint for a line, counted from 0, at which the parser gave up."""
    lines = text.splitlines()
    line = lines[number] if number < len(lines) else ""
    if "'\\t'" in problem:
        return "indent with blanks; YAML allows no tabs there"
    if _TYPOGRAPHIC.search(line):
        return "write straight quotes, \" or '; these are typographic ones, as word processors put them in"
    if problem.startswith("expected <block end>"):
        return "indent entries of one list or map alike; is this line too far in, or one before it?"
    if problem.startswith("expected ',' or"):
        return "is a comma missing, or a closing bracket or quote, here or in a line before?"
    return None


# where a value or a key begins; within words and comments they are letters like others
_TYPOGRAPHIC = re.compile("(?:^|[-:,\\[{])\\s*[\u201c\u201d\u201e\u2018\u2019\u201a\u00ab\u00bb]")


class _Composer:
    """Builds the tree from the event stream and keeps count."""

    def __init__(self, text: str, file: str, fixed: Position | None) -> None:
        self._file = file
        self._fixed = fixed
        self._events = self._parse(text)
        self._count = 0
        self._anchors: dict[str, tuple[Node, int]] = {}
        self._record_ended = False

    def document(self) -> Node:
        next(self._events)  # start of the stream
        if type(next(self._events)).__name__ == "StreamEndEvent":
            if self._fixed is not None:
                return Node("", self._fixed)
            raise ConfigError("the file is empty", where=Position(self._file, 1, 1))
        root = self._node(next(self._events), 0)
        if self._record_ended:
            return root
        next(self._events)  # end of the document
        after = next(self._events)
        if type(after).__name__ != "StreamEndEvent":
            raise ConfigError("only one YAML document a file is allowed", where=self._where(after))
        return root

    def _parse(self, text: str) -> Iterator[Any]:
        """The parser's events, its errors turned into `ConfigError`."""
        from ruamel.yaml import YAML
        from ruamel.yaml.error import MarkedYAMLError, YAMLError
        from ruamel.yaml.reader import ReaderError

        try:
            yield from YAML(typ="safe", pure=True).parse(text)
        except MarkedYAMLError as error:
            mark = error.problem_mark or error.context_mark
            where = self._fixed or Position(self._file, mark.line + 1 if mark else 1, mark.column + 1 if mark else 1)
            context = f" {error.context}" if error.context else ""
            opened = error.context_mark
            if opened is not None and self._fixed is None and mark is not None and opened.line != mark.line:
                context += f" that starts in line {opened.line + 1}"
            hint = _hint(text, str(error.problem), mark.line if mark else 0)
            raise ConfigError(f"not valid YAML: {error.problem}{context}", where=where, hint=hint) from None
        except ReaderError as error:
            line = text.count("\n", 0, error.position) + 1
            column = error.position - text.rfind("\n", 0, error.position)
            raise ConfigError(
                f"the control character {chr(error.character)!r} is not allowed in YAML",
                where=self._fixed or Position(self._file, line, column),
            ) from None
        except YAMLError as error:
            first = str(error).splitlines()[0]
            raise ConfigError(f"not valid YAML: {first}", where=self._fixed or Position(self._file, 1, 1)) from None

    def _where(self, event: Any) -> Position:
        return self._fixed or Position(self._file, event.start_mark.line + 1, event.start_mark.column + 1)

    def _node(self, event: Any, depth: int) -> Node:
        where = self._where(event)
        kind = type(event).__name__
        known = None
        if kind == "AliasEvent":
            known = self._anchors.get(event.anchor)
            if known is None:
                raise ConfigError(
                    f"the alias *{event.anchor} comes before the end of its anchor &{event.anchor}, or has none",
                    where=where,
                )
        elif event.tag is not None:
            raise ConfigError(f"tags such as {event.tag!r} are not allowed", where=where, hint="remove the tag")
        elif depth > MAX_DEPTH:
            raise ConfigError(f"nested deeper than {MAX_DEPTH} levels", where=where)
        before = self._count
        # an alias counts as all that its anchor holds, or aliases of aliases would grow without limit
        self._count += 1 if known is None else known[1]
        if self._count > MAX_NODES:
            raise ConfigError(f"the document has more than {MAX_NODES} values, aliases expanded", where=where)
        if known is not None:
            return known[0]
        if kind == "ScalarEvent":
            if len(event.value) > MAX_SCALAR:
                raise ConfigError(
                    f"the string {event.value[:20]!r}... is longer than {MAX_SCALAR} characters", where=where
                )
            if (bad := unprintable(event.value)) is not None:
                raise ConfigError(f"the character {bad} is not allowed in a string", where=where)
            node = Node(self._scalar(event.value, where) if event.implicit[0] else event.value, where)
        elif kind == "SequenceStartEvent":
            items = []
            while type(item := next(self._events)).__name__ != "SequenceEndEvent":
                items.append(self._node(item, depth + 1))
            node = Node(items, where)
        else:
            node = Node(self._mapping(depth), where)
        if self._record_ended and depth == 0:
            node = node.value["config"].node
        if event.anchor is not None:
            # only now, so that a node can't hold an alias of itself
            self._anchors[event.anchor] = (node, self._count - before)
        return node

    def _mapping(self, depth: int) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        merged: list[Node] = []
        merge_key: Position | None = None
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            where = self._where(event)
            # a quoted "<<" is a key like others
            is_merge = type(event).__name__ == "ScalarEvent" and event.value == "<<" and event.implicit[0]
            key = self._node(event, depth + 1).value
            value = self._node(next(self._events), depth + 1)
            if is_merge:
                if merge_key is not None:
                    raise ConfigError(f"a second merge key; the first is at {merge_key}", where=where)
                merge_key = where
                merged = value.value if isinstance(value.value, list) else [value]
                if not all(isinstance(node.value, dict) for node in merged):
                    raise ConfigError("a merge key takes an alias of a map, or a list of them", where=value.where)
                continue
            if isinstance(key, str) and len(key) > MAX_KEY:
                raise ConfigError(f"the key {key[:20]!r}... is longer than {MAX_KEY} characters", where=where)
            if not isinstance(key, str):
                hint = "put quotes around it"
                if type(key) is int and key >= 0 and value.value is None:  # a comma in a map has cut it off a number
                    hint = f"{DECIMALS}; put quotes around a name"
                raise ConfigError(f"keys must be strings, got {_shown(key)}", where=where, hint=hint)
            if key in entries:
                raise ConfigError(f"the key {key!r} is given twice; first at {entries[key].where}", where=where)
            entries[key] = Entry(where, value)
            if depth == 0 and key == "config" and next(iter(entries)) == RECORD_KEY:
                self._record_ended = True
                break
        for node in merged:
            for name, entry in node.value.items():
                entries.setdefault(name, entry)
        return entries

    def _scalar(self, text: str, where: Position) -> Any:
        if text in _SPECIAL:
            return _SPECIAL[text]
        whole = _INT.fullmatch(text)
        if not whole and not _FLOAT.fullmatch(text):
            return text
        if len(text) > MAX_DIGITS:
            raise ConfigError(f"the number {text[:20]}... has too many digits", where=where)
        if not whole:
            return float(text)
        return int(text, 0) if text.startswith(("0o", "0x")) else int(text)


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "a map"
    return "a list" if isinstance(value, list) else repr(value)
