"""Reports: artifacts whose numbers are each declared once, from which records, tables, headlines and boxes follow."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import Field
from typing import Any, ClassVar, NamedTuple, TypeGuard, TypeVar

import numpy as np

from sppm_pipeline.nouns.artifact import Artifact, shown

F = TypeVar("F", bound=Callable[..., Any])

KEY = "sppm_numbers"
"""Of the metadata of a field, and of functions, what declares numbers."""


class Headline(NamedTuple):
    """A number that a stage is run for; the terminal shows it after the run.

    Attributes
    ----------
    number : str
        Place in the stage's summary, as columns of sweeps are named: ``"porosity"``, ``"C.1.1"`` (counted from 1). A
        list of numbers is shown as a whole.
    label : str
        How it is called; `number` if empty.
    unit : str
        Its unit; ``"{unit}"`` stands for the entry `unit` of the summary.
    error : str
        Place of the half length of its error bar; empty if it has none. The largest is shown for a list.
    """

    number: str
    label: str = ""
    unit: str = ""
    error: str = ""


class Box(NamedTuple):
    """A number at the top of a report, with its name, what it is compared with, and whether that is far off."""

    label: str
    value: str
    note: str = ""
    bad: bool = False


class Curve(NamedTuple):
    """A curve or, if `points`, a cloud; the page's style gives series 0, 1, 2 their colors and dashes.

    Attributes
    ----------
    x, y : (n,) float
        What is not finite interrupts a curve. In a polar chart, the angle from the right in radians, and the radius.
    label : str
    points : bool
    """

    x: Any
    y: Any
    label: str = ""
    points: bool = False


class Chart(NamedTuple):
    """Curves over one number, or if `polar` over the directions of a plane.

    Attributes
    ----------
    curves : sequence of Curve
    x_label : str
        Below the axis, or below the circle.
    y_label : str
    polar : bool
    """

    curves: Sequence[Curve]
    x_label: str
    y_label: str = ""
    polar: bool = False


class ReportSection(NamedTuple):
    """A section of a report.

    Attributes
    ----------
    title : str
    text : str
        A paragraph.
    rows : sequence of (str, value)
        Numbers and their names.
    charts : sequence of Chart
    pictures : sequence of str
        PNG or SVG files in the run directory.
    boxes : sequence of Box
        Numbers for the top of the report. A section that has some stands before the structure.
    """

    title: str
    text: str = ""
    rows: Sequence[tuple[str, Any]] = ()
    charts: Sequence[Chart] = ()
    pictures: Sequence[str] = ()
    boxes: Sequence[Box] = ()


_UNITS = {
    "mm": "mm", "um": "um", "mm2": "mm²", "mm3": "mm³", "ml": "ml", "g": "g", "s": "s", "n": "N", "mpa": "MPa",
    "mb": "MB", "deg": "°", "nmm": "N mm",
}  # fmt: skip


def readable(name: str) -> tuple[str, str]:
    """Words and unit of the name of a number: ``largest_cup_mm2`` is largest cup, mm²; the unit may be empty."""
    words, _, last = name.rpartition("_")
    unit = _UNITS.get(last.lower(), "") if words else ""
    return (words if unit else name).replace("_", " "), unit


class Number(NamedTuple):
    """The declaration of an entry of the summary.

    Attributes
    ----------
    place : str
        Where it stands, as columns of sweeps are named: ``"k_mean"``, ``"bulk.voigt"``; ``"C.#6.#6"`` for a list of six
        lists of six numbers, ``"solver.*"`` for whatever `solver` holds. What is empty or begins with ``#`` or ``*``
        stands below the name of the field or property.
    label : str
        How headlines call it; its name if empty.
    unit : str
        ``"{unit}"`` stands for the entry `unit` of the summary.
    error : str
        Place of the half length of its error bar.
    box : str
        Name of the box that shows it at the top of a report; it has none if empty.
    optional : bool
        Whether it is left out where it is None.
    column : bool
        Whether it holds numbers, which tables of sweeps have columns for.
    """

    place: str = ""
    label: str = ""
    unit: str = ""
    error: str = ""
    box: str = ""
    optional: bool = False
    column: bool = True

    @property
    def path(self) -> list[str]:
        """Keys of the summary that lead to the value."""
        parts = self.place.split(".")
        return parts[: next((n for n, part in enumerate(parts) if part[0] in "#*"), len(parts))]

    def below(self, name: str) -> Number:
        """The same with its whole place, for a field or property of a name."""
        if self.place and self.place[0] not in "#*":
            return self
        return self._replace(place=f"{name}.{self.place}" if self.place else name)


def number(place: str = "", **details: Any) -> dict[str, Any]:
    """Metadata of a dataclass field that is an entry of the summary; `details` are those of `Number`."""
    return {KEY: (Number(place, **details),)}


TEXT: dict[str, Number] = number(column=False)
"""Metadata of a field that is an entry of the summary and holds no numbers."""


def reports(*places: str | Number, **details: Any) -> Callable[[F], F]:
    """Make what a method returns an entry of the summary, or several entries, a value for each of `places` in order.

    A property is decorated below ``@property``. Without a place, its name is that of the entry; `details` are those of
    `Number`. Where the first entry is optional and the method returns None, all are left out.
    """
    declared = tuple(place if isinstance(place, Number) else Number(place, **details) for place in places or ("",))

    def mark(function: F) -> F:
        setattr(function, KEY, declared)
        return function

    return mark


class Report(Artifact):
    """Base of artifacts that are numbers. Subclasses are frozen dataclasses.

    Fields with the metadata of `number`, and methods and properties under `reports`, are the entries of the summary, in
    the order of the class; those of a base class come first. `reported`, and so the columns of tables, headlines and
    boxes follow from them::

        @dataclass(frozen=True, eq=False)
        class Permittivity(Report):
            '''Permittivity of a cell.'''

            headline = ("relative", "porosity")

            relative: float = field(metadata=number(box="permittivity", error="error"))
            porosity: float = field(metadata=number())
            error: float | None = field(default=None, metadata=number(optional=True))

            @property
            @reports(unit="1/GHz")
            def delay(self) -> float: ...

    Attributes
    ----------
    headline : tuple of str
        Places of the numbers that the terminal shows after a run of a stage that states no headline of its own.
    """

    headline: ClassVar[tuple[str, ...]] = ()
    _entries: ClassVar[dict[str, tuple[Number, ...]]] = {}

    def __init_subclass__(cls) -> None:
        """Collect what the class declares, before `dataclass` takes the fields out of it."""
        super().__init_subclass__()
        entries = dict(cls._entries)
        for name, value in vars(cls).items():
            # the function behind a property or a cached property carries the declaration
            function = getattr(value, "fget", None) or getattr(value, "func", None) or value
            declared = value.metadata.get(KEY) if isinstance(value, Field) else getattr(function, KEY, None)
            if declared:
                entries[name] = tuple(one.below(name) for one in declared)
        cls._entries = entries
        if "reported" not in vars(cls) and "summary" not in vars(cls):
            cls.reported = tuple(number.place for number in cls.entries() if number.column)

    @classmethod
    def entries(cls) -> Iterator[Number]:
        """All entries of the summary, in its order."""
        return (number for declared in cls._entries.values() for number in declared)

    def summary(self) -> dict[str, Any]:
        """The declared entries; arrays stay arrays."""
        found: dict[str, Any] = {}
        for name, declared in self._entries.items():
            value = getattr(self, name)
            value = value() if callable(value) else value
            # an absent entry is left out, so that tables have no empty column for it
            if value is None and declared[0].optional:
                continue
            for number, one in zip(declared, (value,) if len(declared) == 1 else value, strict=True):
                *outer, last = number.path
                inner = found
                for key in outer:
                    inner = inner.setdefault(key, {})
                inner[last] = list(one) if isinstance(one, tuple) else dict(one) if isinstance(one, Mapping) else one
        return found

    def __str__(self) -> str:
        """The numbers, a line for each entry of the summary; what is no number alone is left out."""
        summary = self.summary()
        unit = summary.get("unit") or ""
        lines = [type(self).__name__ + (f", {unit}" if unit else "")]
        for name, value in summary.items():
            if isinstance(value, np.ndarray) and value.ndim == 2:
                rows = ("  ".join(f"{one:11.5g}" for one in row) for row in value.tolist())
                lines += [name, *(f"    {row}" for row in rows)]
            elif not isinstance(value, (str, type(None))):
                lines.append(f"{name:20s} {shown(value)}")
        return "\n".join(lines)

    @classmethod
    def headlines(cls) -> tuple[Headline, ...]:
        """`headline` with labels, units and error bars as they are declared."""
        found = []
        for place in cls.headline:
            parts = place.split(".")
            # a place that leads to several entries, such as `nu`, is shown as a whole under its own name
            entries = (one for one in cls.entries() if one.path == parts[: len(one.path)])
            entry = next(entries, Number(place))
            # an index behind the entry belongs to its error bar, too
            rest = parts[len(entry.path) :]
            error = ".".join([entry.error, *rest]) if entry.error else ""
            found.append(Headline(place, (entry.label or entry.path[-1]) + "".join(rest), entry.unit, error))
        return tuple(found)

    @classmethod
    def report_boxes(cls, summary: Mapping[str, Any], stage: str) -> list[Box]:
        """The numbers that are declared with a `box`, with unit, error bar and the stage that made them."""
        found = []
        for declared in cls.entries():
            values = values_at(summary, declared.path)
            if not declared.box or not values:
                continue
            unit = declared.unit.replace("{unit}", str(summary.get("unit") or ""))
            unit = f" {unit}" if unit else ""
            errors = values_at(summary, declared.error.split("."))
            note = f"± {max(errors):.2g}{unit}, {stage}" if errors else stage
            found.append(Box(declared.box, f"{', '.join(f'{value:.3g}' for value in values)}{unit}", note))
        return found


def is_number(value: Any) -> TypeGuard[float]:
    """Test whether an entry of a recorded summary is a finite number."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def values_at(summary: Any, path: Sequence[str]) -> list[float]:
    """The number, or list of numbers, at a place of a recorded summary; empty if there is anything else."""
    for key in path:
        summary = summary.get(key) if isinstance(summary, Mapping) else None
    values = summary if isinstance(summary, list) else [summary]
    return values if all(map(is_number, values)) else []
