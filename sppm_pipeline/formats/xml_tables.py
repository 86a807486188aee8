"""Long runs of equal elements in XML, such as the vertices of a 3MF mesh, read by a compiled scanner.

The parser is handed everything up to the opening tag of a table. From there on the scanner takes rows like
``<vertex x="1" y="2" z="3"/>``, with attributes in any order and others between them. Where the text is anything else,
if only a comment, the parser gets it and all that follows: it decides what is well-formed, the scanner only saves time.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline.formats.text import Bytes, scan_float, scan_index
from sppm_pipeline.formats.xml_events import XmlReader
from sppm_pipeline.numerics.compiled import jit

_BLANK, _QUOTE, _AMPERSAND, _APOSTROPHE, _SLASH, _LESS, _EQUAL, _GREATER = 32, 34, 38, 39, 47, 60, 61, 62
_UNQUOTED = bytes.maketrans(b"\"'", b"  ")  # the scanners of numbers want a blank at the end of one
_SHORTEST_ROW = len(b'<a x="0" y="0" z="0"/>')
_LONGEST_NUMBER = 400


class Table(NamedTuple):
    """What the scanner looks for.

    Attributes
    ----------
    opening : bytes
        The opening tag, without a prefix or attributes: its namespace is then that of the rows, too.
    tag : str
        ``URI local`` of that tag.
    row : bytes
        The beginning of a row, ``<vertex``.
    names : 3 names of one or two letters
    whole : bool
        Whether the values are whole numbers.
    """

    opening: bytes
    tag: str
    row: bytes
    names: tuple[bytes, bytes, bytes]
    whole: bool


class TableReader(XmlReader):
    """An `XmlReader` that is given rows of tables by `rows`, and all other elements by `start`."""

    tables: tuple[Table, ...] = ()

    def __init__(self, name: str, part: str) -> None:
        super().__init__(name, part)
        self._opened = ""

    def rows(self, table: Table, values: NDArray[np.float64] | NDArray[np.int64]) -> None:
        """Rows (n, 3) of a table were read, in their order."""

    def parts(self, chunks: Iterable[bytes]) -> Iterable[bytes]:
        """What is left for the parser."""
        rest = b""
        longest = max((len(table.opening) for table in self.tables), default=1)
        inside: Table | None = None
        for chunk in chunks:
            text = rest + chunk
            rest = b""
            while text:
                if inside is not None:
                    end = self._scan(inside, text)
                    rest = text[end:]
                    if b">" in rest or len(rest) > len(chunk):
                        inside, text, rest = None, rest, b""  # here is no row
                        continue
                    break
                place, found = min(
                    ((text.find(table.opening), table) for table in self.tables if table.opening in text),
                    default=(-1, None),
                    key=lambda pair: pair[0],
                )
                if found is None:
                    keep = longest - 1 if b"<" in text[-longest + 1 :] else 0
                    text, rest = text[: len(text) - keep], text[len(text) - keep :]
                    yield text
                    break
                end = place + len(found.opening)
                self._opened = ""
                yield text[:end]
                # in a comment it opens nothing
                inside = found if self._opened == found.tag else None
                text = text[end:]
        yield rest

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._opened = tag
        super()._start(tag, attributes)

    def _scan(self, table: Table, text: bytes) -> int:
        """Take the rows at the beginning of the text; returns where they end."""
        most = len(text) // _SHORTEST_ROW
        values: NDArray[Any] = np.empty((most, 3), np.int64 if table.whole else np.float64)
        pending = np.empty((0 if table.whole else 3 * most, 3), np.int64)
        data = np.frombuffer(text, np.uint8)
        unquoted = np.frombuffer(text.translate(_UNQUOTED), np.uint8)
        scan = _scan_wholes if table.whole else _scan_floats
        names = np.array([[*name.ljust(2, b"\0"), len(name)] for name in table.names], np.int64)
        row = np.frombuffer(table.row, np.uint8)
        end, count, n_pending = scan(data, unquoted, row, names, values, pending)
        flat = values.reshape(-1)
        for place, first, last in pending[:n_pending].tolist():
            try:
                flat[place] = real(text[first:last].decode("ascii"))
            except ValueError:
                self.count(0, text.count(b"\n", 0, first))
                self.fail(f"a number is expected, not {text[first : min(last, first + 40)]!r}")
        self.count(count, text.count(b"\n", 0, end))
        self.rows(table, values[:count])
        return int(end)


def real(text: str) -> float:
    """A number, which Python writes in more ways than XML does.

    Raises
    ------
    ValueError
        If it is none.
    """
    if "_" in text or len(text) > _LONGEST_NUMBER:
        raise ValueError
    return float(text)


@jit
def _attribute(data: Bytes, i: int) -> tuple[int, int]:
    """Start and end of an attribute's name after a blank at i; end 0 if there is none that is followed by a quote."""
    start = i
    while start < data.size and data[start] <= _BLANK:
        start += 1
    end = start
    while end < data.size and data[end] > _BLANK and data[end] != _EQUAL and data[end] != _SLASH:
        if data[end] == _LESS or data[end] == _GREATER or data[end] == _AMPERSAND or data[end] == _QUOTE:
            return start, 0
        end += 1
    quoted = end + 1 < data.size and data[end] == _EQUAL and (data[end + 1] == _QUOTE or data[end + 1] == _APOSTROPHE)
    return start, end if quoted and start > i and end > start else 0


@jit
def _column(data: Bytes, start: int, end: int, names: NDArray[np.int64]) -> int:
    """Which of the three names stands there; -1 if none."""
    for c in range(3):
        same = end - start == names[c, 2] and data[start] == names[c, 0]
        if same and (names[c, 2] == 1 or data[start + 1] == names[c, 1]):
            return c
    return -1


@jit
def _row_begins(data: Bytes, i: int, row: Bytes) -> int:
    """Where the attributes of the next row begin; -1 if there is no row."""
    while i < data.size and data[i] <= _BLANK:
        i += 1
    if i + row.size >= data.size:
        return -1
    for k in range(row.size):
        if data[i + k] != row[k]:
            return -1
    return i + row.size


@jit
def _row_ends(data: Bytes, i: int) -> int:
    """Where a row ends, if nothing but its ``/>`` follows; else -1."""
    while i < data.size and data[i] <= _BLANK:
        i += 1
    return i + 2 if i + 1 < data.size and data[i] == _SLASH and data[i + 1] == _GREATER else -1


@jit
def _other_value_ends(data: Bytes, i: int, quote: int) -> int:
    """Where the value of an attribute ends that nobody asks for; -1 if the parser has to look at it."""
    while i < data.size and data[i] != quote:
        if data[i] == _LESS or data[i] == _AMPERSAND:
            return -1
        i += 1
    return i if i < data.size else -1


@jit
def _scan_floats(
    data: Bytes,
    unquoted: Bytes,
    row: Bytes,
    names: NDArray[np.int64],
    values: NDArray[np.float64],
    pending: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Rows of real numbers; returns the place after the last whole row, the number of rows and of pending values."""
    done, count, p = 0, 0, 0
    while count < values.shape[0]:
        i = _row_begins(data, done, row)
        if i < 0:
            break
        seen, q = 0, p
        end = _row_ends(data, i)
        while end < 0:
            start, stop = _attribute(data, i)
            if stop == 0:
                break
            quote, i = data[stop + 1], stop + 2
            c = _column(data, start, stop, names)
            if c < 0:
                i = _other_value_ends(data, i, quote)
                if i < 0:
                    break
            else:
                value, last, exact = scan_float(unquoted, i)
                if seen >> c & 1 or last == i or last >= data.size or data[last] != quote:
                    break
                values[count, c] = value
                if not exact:
                    pending[q, 0], pending[q, 1], pending[q, 2] = 3 * count + c, i, last
                    q += 1
                seen |= 1 << c
                i = last
            i += 1
            end = _row_ends(data, i)
        if end < 0 or seen != 7:
            break
        done, p = end, q
        count += 1
    return done, count, p


@jit
def _scan_wholes(
    data: Bytes,
    unquoted: Bytes,
    row: Bytes,
    names: NDArray[np.int64],
    values: NDArray[np.int64],
    pending: NDArray[np.int64],
) -> tuple[int, int, int]:
    """Rows of whole numbers, as `_scan_floats` does it; nothing is left pending."""
    done, count = 0, 0
    while count < values.shape[0]:
        i = _row_begins(data, done, row)
        if i < 0:
            break
        seen = 0
        end = _row_ends(data, i)
        while end < 0:
            start, stop = _attribute(data, i)
            if stop == 0:
                break
            quote, i = data[stop + 1], stop + 2
            c = _column(data, start, stop, names)
            if c < 0:
                i = _other_value_ends(data, i, quote)
                if i < 0:
                    break
            else:
                value, last, found = scan_index(unquoted, i)
                if not found or seen >> c & 1 or last >= data.size or data[last] != quote:
                    break
                values[count, c] = value
                seen |= 1 << c
                i = last
            i += 1
            end = _row_ends(data, i)
        if end < 0 or seen != 7:
            break
        done = end
        count += 1
    return done, count, 0
