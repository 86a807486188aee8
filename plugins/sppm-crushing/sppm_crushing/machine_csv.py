"""Readings of a test machine: text files with a column of force and one of displacement, as machines write them.

Delimiter, decimal comma, encoding, block of text in front, names and units of columns are detected and reported. What
is ambiguous is refused, with the option that decides it.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sppm_pipeline import InputError

UNITS: Mapping[str, Mapping[str, float]] = {
    "force": {
        "N": 1.0, "mN": 1e-3, "cN": 1e-2, "daN": 10.0, "kN": 1e3, "MN": 1e6, "gf": 9.80665e-3, "kgf": 9.80665,
        "kp": 9.80665, "lbf": 4.4482216152605, "lb": 4.4482216152605, "kip": 4448.2216152605, "klbf": 4448.2216152605,
    },
    "displacement": {
        "mm": 1.0, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "cm": 10.0, "m": 1e3, "in": 25.4, "inch": 25.4, "inches": 25.4,
        "mil": 0.0254, '"': 25.4, "毫米": 1.0,
    },
    "stress": {
        "MPa": 1.0, "N/mm2": 1.0, "N/mm²": 1.0, "N/mm^2": 1.0, "Pa": 1e-6, "kPa": 1e-3, "GPa": 1e3, "bar": 0.1,
        "psi": 4.4482216152605 / 25.4**2, "ksi": 4448.2216152605 / 25.4**2,
    },
    "strain": {"%": 0.01, "mm/mm": 1.0, "in/in": 1.0, "m/m": 1.0, "1": 1.0, "-": 1.0},
}  # fmt: skip
"""Newtons, millimeters, MPa and strain in units of files, exact by definition (international pound and inch)."""

NAMES: Mapping[str, tuple[str, ...]] = {
    "force": (
        "force", "load", "compressive load", "compressive force", "standard force", "kraft", "standardkraft",
        "prüfkraft", "druckkraft", "试验力", "力", "力值", "负荷", "载荷", "压力",
    ),
    "displacement": (
        "displacement", "extension", "compressive extension", "compressive displacement", "crosshead", "deflection",
        "deformation", "position", "stroke", "travel", "weg", "standardweg", "traversenweg", "verformung",
        "verschiebung", "位移", "变形", "行程",
    ),
    "stress": ("stress", "compressive stress", "spannung", "druckspannung", "应力"),
    "strain": ("strain", "compressive strain", "stauchung", "dehnung", "应变"),
}  # fmt: skip
"""Names of the columns in files of machines, in lower case."""

MAX_HEADING = 200
"""Characters of a heading that are looked at."""

_BRACKETS = re.compile(r"(?P<name>.*?)\s*[\[(（]\s*(?P<unit>[^\])）]*?)\s*[\])）]\s*")

_BEHIND = re.compile(r"(?P<name>.*?)(?:\s*[/_,]\s*|\s+(?:in\s+)?)(?P<unit>\S+)\s*")

_KNOWN = {unit.casefold() for units in UNITS.values() for unit in units} - {"1", "-"}


class Column(NamedTuple):
    """A column of the table: its number, heading, and the unit that heading or unit row state; empty if none."""

    number: int
    heading: str
    unit: str

    def __str__(self) -> str:
        return repr(self.heading) if self.heading else f"number {self.number + 1}"


def columns_of(head: Sequence[Sequence[str]], width: int, delimiter: str, name: str) -> list[Column]:
    """Headings and units of the columns of a table below a block of text."""
    rows = [row[: max(i for i, cell in enumerate(row) if cell) + 1] for row in head[-4:]]
    fitting = [row for row in rows if 1 < len(row) <= width]
    unit_row = fitting.pop() if fitting and _is_unit_row(fitting[-1]) else []
    headings = fitting[-1] if fitting else []
    if delimiter == "," and 1 < len(headings) < width:
        raise InputError(
            f"{name}: {width} numbers stand below {len(headings)} headings; are there commas both in and between them?",
            hint="export with another delimiter, or with decimal points",
        )
    columns = []
    for number in range(width):
        heading = headings[number] if number < len(headings) else ""
        unit = unit_row[number].strip("[]()（） ") if number < len(unit_row) else ""
        columns.append(Column(number, heading, unit or _split(heading)[1]))
    return columns


def _split(heading: str) -> tuple[str, str]:
    """A heading in lower case with single blanks between its words, and the unit that it states."""
    # no machine writes longer headings, and the patterns take quadratic time
    heading = heading[:MAX_HEADING]
    match = _BRACKETS.fullmatch(heading) or _BEHIND.fullmatch(heading)
    if match and (match.re is _BRACKETS or match["unit"].casefold() in _KNOWN):
        heading, unit = match["name"], match["unit"]
    else:
        unit = ""
    return " ".join(heading.casefold().replace("_", " ").split()), unit


def _is_unit_row(row: Sequence[str]) -> bool:
    known = _KNOWN | {"s", "sec", "min", "h", "hz", "°c", "v"}
    words = [cell.strip("[]()（） ") for cell in row]
    # a majority: some columns have no unit, others one that is not known here
    return sum(word.casefold() in known for word in words) > 0.5 * sum(bool(word) for word in words)


def chosen(
    table: Sequence[Column], columns: Sequence[str], units: Sequence[str], name: str
) -> tuple[Column, Column, tuple[str, str]]:
    """The columns of load and way, by the names asked for or those that machines give them, and what they hold."""
    there = ", ".join(str(column) for column in table)
    hint = f"name them: columns: [force, displacement], by heading or number; there are {there}"
    if columns:
        load, way = (_named(table, wanted, name, there) for wanted in columns)
        if load.number == way.number:
            raise InputError(f"{name}: `columns` names column {load} twice", hint=hint)
        given = units or (load.unit, way.unit)
        kinds = tuple(
            next((kind for kind in pair if _unit_of(unit, kind) is not None), pair[0])
            for pair, unit in zip((("force", "stress"), ("displacement", "strain")), given, strict=True)
        )
        return load, way, (kinds[0], kinds[1])
    found = []
    for first, second in (("force", "stress"), ("displacement", "strain")):
        for kind in (first, second):
            fitting = _candidates(table, kind)
            if len(fitting) > 1:
                which = ", ".join(str(column) for column in fitting)
                raise InputError(f"{name}: columns {which} could all be the {kind}", hint=hint)
            if fitting:
                found.append((fitting[0], kind))
                break
        else:
            raise InputError(f"{name}: no column is called {first} or {second}, in any language known here", hint=hint)
    (load, load_kind), (way, way_kind) = found
    return load, way, (load_kind, way_kind)


def _candidates(table: Sequence[Column], kind: str) -> list[Column]:
    """Columns whose heading is a name of a quantity; if there are none, those whose heading holds one as a word."""
    # "load" alone wins over "load cell temperature", which only holds the word
    exact = [column for column in table if _split(column.heading)[0] in NAMES[kind]]
    words = re.compile("|".join(rf"\b{re.escape(n)}\b" if n < "一" else re.escape(n) for n in NAMES[kind]))
    return exact or [column for column in table if words.search(_split(column.heading)[0])]


def _named(table: Sequence[Column], wanted: str, name: str, there: str) -> Column:
    fitting = [c for c in table if c.heading == wanted] or [
        c for c in table if _split(c.heading)[0] == _split(wanted)[0]
    ]
    if not fitting and wanted.isdigit() and 1 <= int(wanted) <= len(table):
        return table[int(wanted) - 1]
    if len(fitting) != 1:
        many = "is the heading of several columns" if fitting else "is no column"
        raise InputError(f"{name}: {wanted!r} {many}", hint=f"there are {there}, numbered from 1")
    return fitting[0]


def _unit_of(unit: str, kind: str) -> float | None:
    """Factor from a unit to N, mm, MPa or strain; letters of another case count where only one unit can be meant."""
    units = UNITS[kind]
    alike = [factor for known, factor in units.items() if known.casefold() == unit.casefold()]
    return units.get(unit, alike[0] if len(alike) == 1 else None)


def factor_of(unit: str, kind: str, column: Column, name: str) -> float:
    """Factor from a unit to N, mm, MPa or strain; an error where the unit is unknown or missing."""
    factor = _unit_of(unit, kind)
    if factor is None:
        raise InputError(
            f"{name}: the unit of column {column} is {unit!r}, which is none of a {kind}" if unit else
            f"{name}: no unit is given for column {column}, the {kind}",
            hint=f"say both: units: [N, mm]; known for a {kind} are {', '.join(UNITS[kind])}",
        )  # fmt: skip
    return factor


MAX_BYTES = 512 * 2**20
"""Bytes; larger files are refused before they are read."""

MAX_HEAD = 2000
"""Lines within which the table must begin."""


_GROUPED = r"[1-9]\d{0,2}(?:[.,'’ \u00a0\u202f]\d{3})+(?:[.,]\d*)?"
_NUMBER = re.compile(rf"[-+]?(?:{_GROUPED}|\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][-+]?\d+)?")
_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+")
# A unit in brackets belongs to the word before it. The bound keeps lines of open brackets from taking quadratic time.
_WORDS = re.compile(r"\S+(?:[ \t]+[\[(（][^\[\](（）)]{0,40}[\])）])?")
_OVERFLOW = re.compile(r"\*{2,}|#{2,}|[-+]?inf|ovl|over(?:flow|load|range)?", re.IGNORECASE)
"""Cells that machines print where a reading exceeds its channel."""


class Readings(NamedTuple):
    """Readings (n,) of a file, and the format, columns and units that were detected."""

    load: NDArray[np.float64]  # newtons of "force", or MPa of "stress"
    way: NDArray[np.float64]  # millimeters of "displacement", or "strain"
    load_kind: str
    way_kind: str
    notes: tuple[str, ...]


def read_readings(
    data: bytes, name: str, *, columns: Sequence[str] = (), units: Sequence[str] = (), decimal: str = "auto"
) -> Readings:
    """Read a file, which messages call `name`.

    `columns` (load, way) are headings, or numbers from 1 on; `units` are used instead of what the file says; `decimal`
    is "auto", "point" or "comma". `InputError` if the file can't be read, or is ambiguous.
    """
    text, encoding = _decoded(data)
    if not text.strip():
        raise InputError(f"{name} is empty")
    delimiter = _delimiter(text, name)
    head, width = _head(text, delimiter, name)
    table = columns_of(head, width, delimiter, name)
    load, way, kinds = chosen(table, columns, units, name)
    cells, first, last, left = _cells(text, delimiter, len(head), (load, way), name)
    mark = _decimal(cells, decimal, name)
    values = []
    factors = []
    for column, kind, given, texts in zip((load, way), kinds, units or ("", ""), cells, strict=True):
        unit = given or column.unit
        factors.append((unit, factor_of(unit, kind, column, name)))
        values.append(factors[-1][1] * _numbers(texts, mark, column, name))
    separator = {"\t": "tabs", " ": "blanks"}.get(delimiter, repr(delimiter))
    notes = (
        f"{name}: {encoding}, {separator} between columns, decimal {mark}, lines {first} to {last}",
        *(
            f"{kind} from column {column} in {unit}"
            for kind, column, (unit, _) in zip(kinds, (load, way), factors, strict=True)
        ),
        *([f"{left} lines behind the table were not read"] if left else []),
    )
    return Readings(values[0], values[1], *kinds, notes)


def _decoded(data: bytes) -> tuple[str, str]:
    # a byte order mark decides; then zero bytes in every second place, which is UTF-16 of ASCII
    for mark, codec in ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if data.startswith(mark):
            return data[len(mark) :].decode(codec, "replace"), codec.upper()
    sample = data[:4000]
    for codec, odd in (("utf-16-le", sample[1::2]), ("utf-16-be", sample[::2])):
        if len(odd) > 8 and odd.count(0) > 0.6 * len(odd):
            return data.decode(codec, "replace"), codec.upper()
    try:
        return data.decode("utf-8"), "UTF-8"
    except UnicodeDecodeError:
        pass
    # GB18030 decodes nearly anything: it is taken only if a known Chinese heading comes out
    chinese = data.decode("gb18030", "replace")
    if any(
        name in chinese[:100_000] for names in NAMES.values() for name in names if not name.isascii() and name > "一"
    ):
        return chinese, "GB18030"
    return data.decode("cp1252", "replace"), "Windows-1252"


def _rows(text: str, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Line numbers from 1 on, and stripped cells; lines without any are passed over."""
    lines = io.StringIO(text, newline=None)
    if delimiter == " ":
        for number, line in enumerate(lines, 1):
            if cells := _WORDS.findall(line):
                yield number, cells
        return
    reader = csv.reader(lines, delimiter=delimiter)
    for cells in reader:
        if any(cell.strip() for cell in cells):
            yield reader.line_num, [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _delimiter(text: str, name: str) -> str:
    """The one by which most lines of the beginning fall into numbers, two or more in each."""
    start = "".join(line for line, _ in zip(io.StringIO(text, newline=None), range(MAX_HEAD), strict=False))
    best, most = "", 0.0
    for delimiter in ("\t", ";", ",", " "):
        score = 0.0
        try:
            for _, cells in _rows(start, delimiter):
                filled = [cell for cell in cells if cell]
                numbers = sum(map(_is_number, filled))
                score += numbers / len(filled) if numbers > 1 else 0.0
        except csv.Error:
            pass  # what comes before counts; the line is met again, and reported, when the table is read
        if score > most + 1e-9:
            best, most = delimiter, score
    if not best:
        raise InputError(
            f"{name} holds no table: no line has two numbers",
            hint="export the readings as text, with a column of force and one of displacement",
        )
    return best


def _head(text: str, delimiter: str, name: str) -> tuple[list[list[str]], int]:
    """The rows in front of the table, and the number of cells of its first row."""
    rows: list[list[str]] = []
    numeric: list[bool] = []
    for number, cells in _rows(text, delimiter):
        if number > MAX_HEAD:
            break
        rows.append(cells)
        numeric.append(sum(map(_is_number, cells)) > 1)
        # one numeric row may be a date or a serial number in the text block; three of one width are the table
        if len(rows) > 2 and all(numeric[-3:]) and len({len(row) for row in rows[-3:]}) == 1:
            return rows[:-3], len(cells)
    if len(rows) > MAX_HEAD:
        raise InputError(f"{name}: no table of numbers begins in the first {MAX_HEAD} lines")
    raise InputError(f"{name} has fewer than three readings", hint="a curve of compression has hundreds of them")


def _cells(
    text: str, delimiter: str, head: int, columns: tuple[Column, Column], name: str
) -> tuple[tuple[list[str], list[str]], int, int, int]:
    """The cells of two columns, first and last line of the table, and lines behind it."""
    a, b = (column.number for column in columns)
    loads: list[str] = []
    ways: list[str] = []
    first = last = behind = 0
    ended: tuple[int, str] | None = None
    try:
        for place, (number, cells) in enumerate(_rows(text, delimiter)):
            if place < head:
                continue
            known = len(cells) > max(a, b) and _is_number(cells[a]) and _is_number(cells[b])
            for column in columns if not known else ():
                if column.number < len(cells) and _OVERFLOW.fullmatch(cells[column.number]):
                    raise InputError(
                        f"{name}: line {number} has {cells[column.number]!r} in column {column}: the reading was too "
                        "large for the machine",
                        hint="end the file before that line, or repeat the test with a larger range",
                    )
            # the reader of CSV takes all lines up to the next quotation mark for one cell
            if any("\n" in cell for cell in cells):
                raise InputError(f"{name}: a quotation mark in line {last + 1} is not closed")
            if not known:
                wrong = next((c for c in (a, b) if c >= len(cells) or not _is_number(cells[c])), a)
                ended = ended or (number, cells[wrong] if wrong < len(cells) else "")
                behind += 1
            elif ended is not None:
                raise InputError(
                    f"{name}: line {ended[0]} has {ended[1][:40]!r} for a number, and the table goes on in line "
                    f"{number}",
                    hint="take the line out, or leave one table in the file",
                )
            else:
                loads.append(cells[a])
                ways.append(cells[b])
                first, last = first or number, number
    except csv.Error as error:
        raise InputError(f"{name}: the table can't be read behind line {last}: {error}") from error
    if len(loads) < 3:
        raise InputError(f"{name} has {len(loads)} readings in columns {columns[0]} and {columns[1]}")
    return (loads, ways), first, last, behind


def _decimal(cells: tuple[list[str], list[str]], asked: str, name: str) -> str:
    """ "point" or "comma"."""
    if asked != "auto":
        return asked
    texts = {text for texts in cells for text in texts if "," in text or "." in text}
    both = [text for text in texts if "," in text and "." in text]
    if both:
        marks = {"comma" if text.rfind(",") > text.rfind(".") else "point" for text in both}
        if len(marks) > 1:
            raise InputError(f"{name}: commas and points change their meaning", hint="say `decimal: point` or `comma`")
        return marks.pop()
    commas = [text for text in texts if "," in text]
    points = len(texts) > len(commas)
    if not commas:
        return "point"
    # 1,234 alone may be either; beside decimal points, commas between groups of three separate thousands
    grouped = all(_GROUPS.fullmatch(text) for text in commas)
    if points and grouped:
        return "point"
    if points or any(text.count(",") > 1 for text in commas):
        raise InputError(f"{name}: commas and points change their meaning", hint="say `decimal: point` or `comma`")
    if grouped:
        raise InputError(
            f"{name}: {commas[0]!r} may be a number of thousands or one with three decimals",
            hint="say `decimal: comma` or `decimal: point`",
        )
    return "comma"


def _numbers(texts: list[str], mark: str, column: Column, name: str) -> NDArray[np.float64]:
    drop, keep = (",", ".") if mark == "point" else (".", ",")
    blanks = str.maketrans(dict.fromkeys((drop, "'", "’", " ", "\u00a0", "\u202f")) | {keep: "."})
    try:
        values: NDArray[np.float64] = np.array([text.translate(blanks) for text in texts]).astype(np.float64)
    except ValueError as error:
        raise InputError(f"{name}: column {column} holds what is no number with a decimal {mark}: {error}") from error
    if not np.isfinite(values).all():
        at = int(np.argmin(np.isfinite(values)))
        raise InputError(f"{name}: reading {at + 1} of column {column} is {texts[at]!r}, which is not finite")
    return values
