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


def parse_yaml(text: str, where: str | Position) -> Node:
    """The tree of the only document in `text`, which lies in the file `where`, or all of it at a place."""
    file, fixed = (where, None) if isinstance(where, str) else (where.file, where)
    refuse_unparsed(text, file, fixed)
    return _Composer(text, file, fixed).document()


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
        _check_string(value, where)
    elif value is not None and not isinstance(value, (bool, int, float)):
        raise ConfigError(f"a configuration can't hold {type(value).__name__}: {value!r:.60}", where=where)
    return Node(value, where)


def _check_string(text: str, where: Position) -> None:
    if len(text) > MAX_SCALAR:
        raise ConfigError(f"the string {text[:20]!r}... is longer than {MAX_SCALAR} characters", where=where)
    if (bad := unprintable(text)) is not None:
        raise ConfigError(f"the character {bad} is not allowed in a string", where=where)


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
            raise ConfigError(
                f"the control character {chr(error.character)!r} is not allowed in YAML",
                where=self._fixed or _place(text, error.position, self._file),
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
            _check_string(event.value, where)
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


MAX_BYTES = 1 << 18
"""Bytes of a configuration file."""

MAX_RECORD = 1 << 20
"""Bytes of a run record that its configuration has to lie in; there all defaults are written out."""

MAX_LINE = 1 << 16
"""Characters of a line."""

MAX_SCALAR = 4096
"""Characters of one value, or of anything else that is written without blanks, such as a tag or an anchor."""

MAX_KEY = 200
"""Characters of a key."""

MAX_DIGITS = 1000
"""Characters of a number."""

MAX_DEPTH = 32
"""Levels of lists and maps."""

MAX_NODES = 20_000
"""Values, counted with every alias and every parameter expanded."""

# each looks only from where a line or a word begins: from every character on, it would take quadratic time
_LONG_LINE = re.compile(rf"(?<![^\r\n\x85\u2028\u2029])[^\r\n\x85\u2028\u2029]{{{MAX_LINE + 1}}}")
_LONG_WORD = re.compile(rf"(?<![^\s,\[\]{{}}])[^\s,\[\]{{}}]{{{MAX_SCALAR + 1}}}")
_DEEP = re.compile(rf"(?:[\[{{][ \t]*+){{{2 * MAX_DEPTH + 1}}}")
"""Brackets on brackets: the parser buffers a thousand of them, in quadratic time."""

_ENCODINGS = {
    b"\xff\xfe\x00\x00": "UTF-32",
    b"\x00\x00\xfe\xff": "UTF-32",
    b"\xff\xfe": "UTF-16",
    b"\xfe\xff": "UTF-16",
    b"\x1f\x8b": "compressed by gzip",
    b"PK\x03\x04": "a ZIP archive",
}
_UNPRINTABLE = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x84\x86-\x9f\ud800-\udfff\ufeff\ufffe\uffff"
    r"\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"  # marks that turn the order of letters round on a screen
)


def decoded(data: bytes, file: str, *, is_record: bool = False) -> str:
    """The text of a configuration file; `ConfigError` with line and column if it is too large or no UTF-8."""
    top = Position(file, 1, 1)
    if (bad := unprintable(file)) is not None:
        raise ConfigError(f"the name of the file has the character {bad}", hint="rename the file")
    if len(data) > MAX_BYTES and not is_record:
        raise ConfigError(f"the file is larger than {MAX_BYTES >> 10} KiB, which no configuration needs", where=top)
    for mark, name in _ENCODINGS.items():
        if data.startswith(mark):
            raise ConfigError(f"the file is {name}, not UTF-8", where=top, hint="save the file as UTF-8")
    try:
        return data[:MAX_RECORD].decode("utf-8-sig", "ignore" if is_record else "strict")
    except UnicodeDecodeError as error:
        # columns count characters, and bytes before the first bad one are sound
        before = data[: error.start].decode("utf-8-sig", "replace")
        raise ConfigError(
            f"byte 0x{data[error.start]:02x} is not UTF-8",
            where=_place(before, len(before), file), hint="save the file as UTF-8",
        ) from None  # fmt: skip


def refuse_unparsed(text: str, file: str, fixed: Position | None = None) -> None:
    """Refuse, at line and column, what need not be parsed to be refused; `fixed` is the place of all of a text of the
    command line.
    """
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        # a directive, which comes before all content
        if words[:1] == ["%YAML"] and words[1:2] not in (["1.1"], ["1.2"]):
            raise ConfigError(
                f"the file says that it is YAML {' '.join(words[1:2])[:20]}, which can't be read",
                where=fixed or Position(file, number, 1), hint="remove the line, or write %YAML 1.2",
            )  # fmt: skip
        if words and not line.startswith(("%", "#")):
            break
    for pattern, message in (
        (_LONG_LINE, f"the line is longer than {MAX_LINE} characters, which no configuration needs"),
        (_LONG_WORD, f"more than {MAX_SCALAR} characters without a blank, starting {{word}}"),
        (_DEEP, f"nested deeper than {MAX_DEPTH} levels"),
    ):
        if (found := pattern.search(text)) is not None:
            place = fixed or _place(text, found.start(), file)
            raise ConfigError(message.replace("{word}", repr(found[0][:20])), where=place)


def parsable(text: str) -> str:
    """The beginning of `text` that is not refused unparsed; of a record, what comes after is not read anyway."""
    found = [match.start() for pattern in (_LONG_LINE, _LONG_WORD, _DEEP) if (match := pattern.search(text))]
    return text[: min(found)] if found else text


def unprintable(text: str) -> str | None:
    """The first character of `text` that no name or label may hold, as an escape; None if there is none."""
    found = _UNPRINTABLE.search(text)
    return None if found is None else f"\\u{ord(found[0]):04x}"


def _place(text: str, offset: int, file: str) -> Position:
    """Line and column of a character."""
    return Position(file, text.count("\n", 0, offset) + 1, offset - text.rfind("\n", 0, offset))
