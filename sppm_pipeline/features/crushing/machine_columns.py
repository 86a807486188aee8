"""Columns of a test machine's table: what their headings and units say, and which are the load and the way."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

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
