"""``grade.table``: a parameter given by values at places along an axis."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, SurfaceMesh, option, options
from sppm_pipeline.errors import did_you_mean
from sppm_pipeline.features.grading.grader import Grader
from sppm_pipeline.features.grading.laws import TableLaw
from sppm_pipeline.method.nouns.maps import COORDINATES, Grading
from sppm_pipeline.nouns.length import UNITS_IN_MM


@dataclass(frozen=True, kw_only=True)
class GradeTable(Grader):
    """Let a parameter follow a table: values at places along x, y or z, or over an earlier map.

    Before the first place and behind the last the table goes on with the value there. With steps a value holds from
    its place to the next.
    """

    name: ClassVar[str] = "grade.table"

    along: str = option("z", help="x, y, z, or the name of an earlier map that the places are values of")
    unit: str = options.unit(
        "mm", note="cells are counted from the low corner of the part's lattice", choices=("cells", *UNITS_IN_MM)
    )
    between: str = option(
        "linear",
        help="what is between two places: the value of the lower one, a straight line, or a smooth curve that does "
        "not go beyond them",
        choices=("steps", "linear", "smooth"),
    )
    values: tuple[tuple[float, float], ...] = option(
        help="[place, value] pairs in ascending order of the places", minimum=-1e15, maximum=1e15
    )

    def check_options(self) -> None:
        super().check_options()
        if not self.values:
            raise ConfigError("`values` is empty", hint="give [place, value] pairs, for example [[0, 0.3], [10, 0.7]]")
        places = [place for place, _ in self.values]
        for before, after in pairwise(places):
            if not after > before:
                raise ConfigError(
                    f"`values`: the place {after:g} follows {before:g}; places must ascend",
                    hint="sort the pairs; for a jump write two places close to each other, or `between: steps`",
                )
        if self.along not in COORDINATES and self.unit != "mm":
            raise ConfigError(f"`unit` means nothing along {self.along!r}", hint="places have the unit of that map")

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> TableLaw:
        """The table."""
        along, factor = self.along, 1.0
        if along in COORDINATES:
            # what a cell is, is known only where cells are laid
            along = f"cell_{along}" if self.unit == "cells" else along
            factor = UNITS_IN_MM.get(self.unit, 1.0)
        elif along not in before:
            hint = did_you_mean(along, [*COORDINATES, *before.names])
            raise ConfigError(f"`along: {along[:40]}` is neither x, y, z nor an earlier map", hint=hint)
        pairs = np.array(self.values, np.float64)
        places, values = factor * pairs[:, 0], self.factor * pairs[:, 1]
        return TableLaw(self.of, self.unit_of_values, along, places, values, self.between)
