"""``grade.stiffness``: the porosity that gives a structure the Young's modulus that a map asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from sppm_pipeline.data.grading import Grading
from sppm_pipeline.data.grading_data import StiffnessLaw
from sppm_pipeline.data.mesh import SurfaceMesh
from sppm_pipeline.data.palette import Palette
from sppm_pipeline.data.size import Size
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.families import options
from sppm_pipeline.families.grader import Grader
from sppm_pipeline.stage import Context, Headline, option


@dataclass(frozen=True, kw_only=True)
class GradeStiffness(Grader):
    """Let the porosity follow a map of target Young's moduli, by the structure's own curve of modulus over porosity.

    The curve comes from homogenized cells: a CSV file, such as the `sweep.csv` of the configuration stiffness_map, or
    pairs of numbers. Cells that scatter are averaged in groups, and the logarithm of the modulus goes monotonically
    through the means. A modulus beyond the curve is refused with its place. `check.local_porosity` then writes the
    modulus, too, that the measured porosity has by the curve.
    """

    name: ClassVar[str] = "grade.stiffness"
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("modulus_min", "moduli from"), Headline("modulus_max", "to"),
        Headline("deviation", "scatter of cells around the curve"),
    )  # fmt: skip
    reported: ClassVar[tuple[str, ...]] = (
        "cells", "modulus_min", "modulus_max", "porosity_min", "porosity_max", "deviation",
    )  # fmt: skip

    of: str = option("porosity", help="name of the map that is made")
    wanted: str = option("stiffness", help="name of the earlier map of target moduli")
    path: Path | None = options.read_path(None, note="a CSV file of homogenized cells")
    columns: tuple[str, ...] = options.columns(
        ("porosity", "stiffness"), note="porosity and modulus, in the file at `path`", column=False
    )
    values: tuple[tuple[float, float], ...] = option(
        (), help="[porosity, modulus] pairs instead of a file", above=0, maximum=1e15
    )
    young: float = options.young(
        1.0, note="moduli of the curve are multiplied by it; 1 if they have the unit of the map already"
    )

    def estimate(self, palette: Palette, grading: Size | None, part: Size | None) -> Size:
        return Size()

    def check_options(self) -> None:
        super().check_options()
        if (self.path is None) == (not self.values):
            raise ConfigError("the curve is either a file, `path`, or pairs, `values`", hint="give one of them")
        if len(self.columns) != 2:
            raise ConfigError(f"`columns` names {len(self.columns)}; it takes two, porosity and modulus")

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> StiffnessLaw:
        """Fit the curve."""
        from sppm_pipeline.numerics.grading.curve import stiffness_curve

        before.law(self.wanted)
        if self.path is not None:
            from sppm_pipeline.formats.csv_columns import read_columns

            cells, where = read_columns(self.path, self.columns, gaps=True), f"{self.path.name}: "
        else:
            cells, where = np.array(self.values, np.float64), "`values`: "
        cells = cells[np.isfinite(cells).all(axis=1)]
        bad = (cells[:, 0] <= 0) | (cells[:, 0] >= 1) | (cells[:, 1] <= 0)
        if bad.any():
            porosity, modulus = cells[int(np.argmax(bad))]
            raise InputError(
                f"{where}a cell of porosity {porosity:g} has the modulus {modulus:g}; porosities lie between 0 and 1, "
                "moduli above 0"
            )
        if len(cells) < 2:
            raise InputError(f"{where}{len(cells)} cells are no curve", hint="give two or more")
        curve = stiffness_curve(cells[:, 0], self.young * cells[:, 1])
        context.report(
            cells=len(cells), deviation=curve.deviation,
            modulus_min=float(curve.moduli[-1]), modulus_max=float(curve.moduli[0]),
            porosity_min=float(curve.porosities[0]), porosity_max=float(curve.porosities[-1]),
        )  # fmt: skip
        return StiffnessLaw(self.of, self.unit_of_values, self.wanted, *curve)
