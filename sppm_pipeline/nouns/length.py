"""Lengths as users write them, and the cell that relates them to the unit cube."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.nouns.artifact import Artifact

CELL_UNIT = "cell"
"""Unit of lengths in cell sizes; a number without a unit is in cell sizes, too, where an option says so."""

UNITS_IN_MM = {"um": 1e-3, "µm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}

_LENGTH = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-zµ]*)\s*")


@dataclass(frozen=True)
class Length:
    """A length as written: a value and, if one was given, a unit.

    Attributes
    ----------
    value : float
    unit : str or None
        A key of `UNITS_IN_MM`, or `CELL_UNIT`; None means the documented unit of the option.
    """

    value: float
    unit: str | None = None

    def __post_init__(self) -> None:
        value: Any = self.value
        if isinstance(value, str):
            raise ValueError(f"a length is a number and its unit, Length(4, 'mm'), got {value!r}")

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}" if self.unit else f"{self.value:g}"

    def mm(self) -> float:
        """The length in millimeters; a bare number is millimeters.

        Raises
        ------
        ConfigError
            If it is in cell sizes.
        """
        if self.unit == CELL_UNIT:
            raise ConfigError(f"the length {self} is in cell sizes, where a physical length is needed")
        return self.value * (UNITS_IN_MM[self.unit] if self.unit else 1.0)

    def in_cells(self, edge_mm: float | None) -> float:
        """The length in cell sizes; a bare number is in cell sizes.

        Raises
        ------
        ConfigError
            If the length has a physical unit and the cell has no physical size.
        """
        if self.unit is None or self.unit == CELL_UNIT:
            return self.value
        if edge_mm is None:
            raise ConfigError(
                f"the length {self} has a physical unit, but the cell has no physical size",
                hint="give the size of the cell on the first stage that makes it, for example `edge: 7.5 mm`, or write "
                "the length as a fraction of the cell size, for example `0.11 cell`",
            )
        return self.mm() / edge_mm


def parse_length(value: object) -> Length:
    """Read ``7.5``, ``"7.5 mm"``, ``"50 um"`` or ``"0.11 cell"``.

    Raises
    ------
    ValueError
        If the value is no finite number, or the unit is unknown.
    """
    if isinstance(value, Length):
        return value
    # before int, of which bool is a subclass
    if isinstance(value, bool):
        raise ValueError(f"expected a length such as 0.16 or '7.5 mm', got {str(value).lower()}")
    if isinstance(value, (int, float)):
        number, unit = float(value), None
    else:
        match = _LENGTH.fullmatch(value) if isinstance(value, str) else None
        if not match:
            raise ValueError(f"expected a length such as 0.16 or '7.5 mm', got {value!r}")
        number, unit = float(match[1]), match[2] or None
        if unit is not None and unit != CELL_UNIT and unit not in UNITS_IN_MM:
            raise ValueError(f"unknown unit {unit!r} in {value!r}; known: {', '.join((*UNITS_IN_MM, CELL_UNIT))}")
    if not math.isfinite(number):
        raise ValueError(f"a length must be finite, got {value!r}")
    return Length(number, unit)


LARGEST_BARE = 0.5
"""Cell sizes up to which `Cell.fraction` takes a number without a unit in a physical cell: no pore, tunnel or gap of a
cell is as large, so a larger number is one in millimeters."""

Pixel = Length | tuple[Length, Length]
"""Pixel pitch as written: one length for square pixels, else those along x and y."""


def voxel_mm(pixel: Pixel, layer: Length | None) -> tuple[float, float, float]:
    """Pixel pitch along x and y, and layer height, in millimeters; without a height layers are as high as pixels.

    Raises
    ------
    ConfigError
        If only one of two pitches has a unit, or pixels that are not square leave the layer height open.
    """
    x, y = pixel if isinstance(pixel, tuple) else (pixel, pixel)
    # a bare number is millimeters here, so that 19 beside 24 um would be 19 mm
    if (x.unit is None) != (y.unit is None):
        raise ConfigError(
            f"of `pixel: [{x}, {y}]` one has a unit and the other has none",
            hint="write both with their unit, for example `pixel: [0.019 mm, 0.024 mm]`",
        )
    # 1e-9 allows for rounding of units, as 50 um and 0.05 mm
    if layer is None and not math.isclose(x.mm(), y.mm(), rel_tol=1e-9):
        raise ConfigError(
            f"`pixel: [{x}, {y}]` needs a `layer`: pixels that are not square don't tell how high a layer is",
            hint="give the layer height of the printer, for example `layer: 0.05 mm`",
        )
    return x.mm(), y.mm(), (x if layer is None else layer).mm()


@dataclass(frozen=True)
class Cell(Artifact):
    """The periodic cube in which pores are designed.

    Inside the program a cell is the unit cube. Lengths without a unit are fractions of its edge.

    Attributes
    ----------
    edge : float
        Edge length: in millimeters of a physical cell, else in the unit of length of the size parameters omega and mu
        (1, or 2 for the paper's cell [-1, 1]^3).
    physical : bool
        Whether the cell has a physical size.
    """

    edge: float = 1.0
    physical: bool = False

    def __post_init__(self) -> None:
        edge: Any = self.edge
        if isinstance(edge, (str, Length)):
            raise ValueError(f"the edge of a cell is a number, Cell(4.0, True) of 4 mm, got {edge!r}")

    def fraction(self, length: Length) -> float:
        """`length` in cell sizes.

        Raises
        ------
        ConfigError
            If the length has a physical unit and the cell has no physical size; or if it has no unit and is likely to
            be meant in the unit of `edge`.
        """
        if length.unit is None and self.physical and length.value > LARGEST_BARE:
            raise ConfigError(
                f"the length {length} has no unit and counts in cell sizes, of {self.edge:g} mm each",
                hint=f"write `{length} mm`, or `{length} cell` if it is {length} cell sizes",
            )
        if length.unit is None and length.value and not self.physical and self.edge != 1:
            raise ConfigError(
                f"the length {length} has no unit, and `edge: {self.edge:g}` is the unit of `omega` and `mu` only",
                hint=f"write `{length.value / self.edge:g} cell` if it is meant in the unit of `edge`, `{length} cell` "
                "if it is a fraction of the cell size",
            )
        return length.in_cells(self.edge if self.physical else None)

    def summary(self) -> dict[str, object]:
        """Edge and its unit."""
        return {"edge": self.edge, "unit": "mm" if self.physical else "cell size"}
