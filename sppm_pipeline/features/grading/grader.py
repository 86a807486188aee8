"""Base classes of stages that say how a parameter varies through a part: one method makes its law."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.method.nouns.maps import (
    BOX_COORDINATES,
    CELL_COORDINATES,
    COORDINATES,
    DISTANCE,
    QUANTITIES,
    DataLaw,
    Grading,
    Law,
)
from sppm_pipeline.method.nouns.mesh import SurfaceMesh
from sppm_pipeline.nouns.length import UNITS_IN_MM
from sppm_pipeline.services.arrays import F64, Bools
from sppm_pipeline.services.expression import CONSTANTS, FUNCTIONS, WORDS
from sppm_pipeline.stage import Context, Headline, Stage, option

RESERVED = frozenset({*COORDINATES, *BOX_COORDINATES, *CELL_COORDINATES, DISTANCE, *FUNCTIONS, *CONSTANTS, *WORDS})
"""Words that have a meaning in formulas."""


@dataclass(frozen=True, kw_only=True)
class Grader(Stage):
    """Common base of the family ``grade``: implement `law`; `run` adds it to the maps made before."""

    of: str = option(
        help="name of the map; other stages look for porosity, spacing, scale, pore_radius, tunnel_radius, stretch, "
        "direction_x, direction_y, direction_z, stretch_across, across_x, across_y, across_z and weight, any "
        "other name is data for formulas"
    )
    measure: str | None = option(
        None,
        help="unit of the values; millimeters for radii, else none if omitted. Radii in other units of length are "
        "converted to millimeters",
    )

    def check_options(self) -> None:
        if not (self.of.isidentifier() and self.of.isascii()) or len(self.of) > 40:
            raise ConfigError(f"`of: {self.of[:50]}` is no name", hint="use letters, digits and _, at most 40")
        if self.of in RESERVED:
            raise ConfigError(f"`of: {self.of}` has a meaning in formulas already", hint="give another name")
        known = QUANTITIES.get(self.of)
        if known is not None and self.measure is not None:
            allowed = tuple(UNITS_IN_MM) if known.unit == "mm" else ("",)
            if self.measure not in allowed:
                words = "no unit" if known.unit != "mm" else "one of " + ", ".join(allowed)
                raise ConfigError(f"`measure: {self.measure[:40]}`: {self.of} has {words}", hint=known.meaning)

    @property
    def unit_of_values(self) -> str:
        """The unit that the map's values have."""
        known = QUANTITIES.get(self.of)
        return known.unit if known is not None else (self.measure or "")[:40]

    @property
    def factor(self) -> float:
        """Factor of the given values, which makes millimeters of lengths."""
        known = QUANTITIES.get(self.of)
        return UNITS_IN_MM[self.measure] if known is not None and known.unit and self.measure else 1.0

    @abstractmethod
    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> Law:
        """Make the law of the map.

        Parameters
        ----------
        context : Context
        before : Grading
            The maps made before; a formula may use them.
        part : SurfaceMesh or None
        """

    def run(self, context: Context, grading: Grading | None, part: SurfaceMesh | None) -> Grading:
        """Add the map to those made before."""
        before = Grading() if grading is None else grading
        return before.added(self.law(context, before, part))


OUTSIDE_WARNED = 0.01
"""Fraction of the part's box without data from which on a warning is given: below it are rims of voxels."""

MAX_OUTSIDE = 0.5
"""Fraction of the part's box without data beyond which they are taken for those of another part, or in another unit."""


@dataclass(frozen=True, kw_only=True)
class DataGrader(Grader):
    """Common base of maps that are data from a file: implement `data`; `law` checks that they lie where the part is."""

    reported: ClassVar[tuple[str, ...]] = ("values", "lowest", "highest")
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("values"), Headline("lowest"), Headline("highest"), Headline("data_box", "in"),
    )  # fmt: skip

    outside: str = option(
        "nearest",
        help="what the map is where there are no data: the nearest value, unless more than half of the part's box has "
        "none; an error; or the nearest value anywhere",
        choices=("nearest", "refuse", "extend"),
    )
    missing: str = option(
        "refuse",
        help="what becomes of data that are no finite numbers: an error, or they are filled from the data around",
        choices=("refuse", "fill"),
    )

    @abstractmethod
    def data(self, context: Context, part: SurfaceMesh | None) -> DataLaw:
        """Read the file."""

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> DataLaw:
        law = self.data(context, part)
        lowest, highest = law.bounds
        context.report(values=int(np.size(vars(law)["values"])), lowest=lowest, highest=highest, data_box=_box(law.box))
        if part is not None:
            low, high = np.maximum(law.box[0], part.lower), np.minimum(law.box[1], part.upper)
            if (high < low).any():
                own = _box(np.array([part.lower, part.upper]))
                raise InputError(
                    f"the data lie in the box {_box(law.box)}, and the part in {own}: they do not meet",
                    hint="are both in the same unit, and in the same place? `unit` is that of the data's coordinates",
                )
            size = np.maximum(part.upper - part.lower, 1e-300)
            share = 1 - float(np.prod((high - low) / size))
            if share > MAX_OUTSIDE and self.outside == "nearest":
                own = _box(np.array([part.lower, part.upper]))
                raise InputError(
                    f"{100 * share:.0f} % of the part's box, {own}, lie outside of the data, which lie in the box "
                    f"{_box(law.box)}",
                    hint="are both in the same unit, and in the same place? `outside: extend` takes the nearest value",
                )
            if share > OUTSIDE_WARNED:
                what = "there the map has no value" if self.outside == "refuse" else "the nearest value is taken there"
                context.warn(f"{100 * share:.0f} % of the part's box lie outside of the data; {what}")
        return law

    def finite(self, values: F64, what: str) -> Bools:
        """Which values are finite numbers; `InputError` if none is, or one is not and that is refused."""
        good: Bools = np.isfinite(values)
        if not good.any():
            raise InputError(f"{what} hold no finite number")
        if self.missing == "refuse" and not good.all():
            raise InputError(
                f"{int((~good).sum())} of {good.size} {what} are no finite numbers",
                hint="repair them, or give `missing: fill` to fill them from those around",
            )
        return good


def _box(box: F64) -> str:
    """A box for a message."""
    low, high = ("(" + ", ".join(f"{v:g}" for v in corner) + ")" for corner in box)
    return f"{low} to {high} mm"
