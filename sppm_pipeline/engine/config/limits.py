"""Limits on the size of a configuration: what is refused before it is parsed, and what while it is.

The parser is written in Python and takes up to a second for a megabyte; some of its tokens take quadratic time. So a
text is held to a size, a length of line and a length of word by expressions that run at the speed of memory, and only
then parsed. The limits leave a hand-written configuration a factor of a hundred.
"""

from __future__ import annotations

import re

from sppm_pipeline.errors import ConfigError, Position

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
    if len(data) > MAX_BYTES and not is_record:
        raise ConfigError(
            f"the file is larger than {MAX_BYTES >> 10} KiB, which no configuration needs", where=Position(file, 1, 1)
        )
    for mark, name in _ENCODINGS.items():
        if data.startswith(mark):
            raise ConfigError(
                f"the file is {name}, not UTF-8", where=Position(file, 1, 1), hint="save the file as UTF-8"
            )
    try:
        return data[:MAX_RECORD].decode("utf-8-sig", "ignore" if is_record else "strict")
    except UnicodeDecodeError as error:
        # columns count characters, and bytes before the first bad one are sound
        before = data[: error.start].decode("utf-8-sig", "replace")
        raise ConfigError(
            f"byte 0x{data[error.start]:02x} is not UTF-8",
            where=_place(before, len(before), file),
            hint="save the file as UTF-8",
        ) from None


def refuse_unparsed(text: str, file: str, fixed: Position | None = None) -> None:
    """Refuse, at line and column, what need not be parsed to be refused; `fixed` is the place of all of a text of the
    command line.
    """
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if words[:1] == ["%YAML"] and words[1:2] not in (
            ["1.1"],
            ["1.2"],
        ):  # a directive, which comes before all content
            raise ConfigError(
                f"the file says that it is YAML {' '.join(words[1:2])[:20]}, which can't be read",
                where=fixed or Position(file, number, 1),
                hint="remove the line, or write %YAML 1.2",
            )
        if words and not line.startswith(("%", "#")):
            break
    found = _LONG_LINE.search(text)
    if found is not None:
        place = fixed or _place(text, found.start(), file)
        raise ConfigError(f"the line is longer than {MAX_LINE} characters, which no configuration needs", where=place)
    found = _LONG_WORD.search(text)
    if found is not None:
        place = fixed or _place(text, found.start(), file)
        raise ConfigError(f"more than {MAX_SCALAR} characters without a blank, starting {found[0][:20]!r}", where=place)
    found = _DEEP.search(text)
    if found is not None:
        raise ConfigError(f"nested deeper than {MAX_DEPTH} levels", where=fixed or _place(text, found.start(), file))


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
