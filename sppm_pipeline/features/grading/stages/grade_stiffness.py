"""``grade.stiffness``: the porosity that gives a structure the Young's modulus that a map asks for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, cast

import numpy as np

from sppm_pipeline import Microstructure, Palette, RecipeSize, Size, SurfaceMesh, options
from sppm_pipeline.built_in import stage_class
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.grading.grader import Grader
from sppm_pipeline.features.grading.laws import StiffnessLaw
from sppm_pipeline.features.grading.numerics.curve import stiffness_curve
from sppm_pipeline.features.grading.rounds import curve_of, recipe_total, trial
from sppm_pipeline.method.families.homogenizer import Quiet
from sppm_pipeline.method.nouns.maps import Grading
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.arrays import F64
from sppm_pipeline.stage import Context, Headline, Recipe, option

TRIED = 6
"""Numbers of pores that usually cover porosities from 0.3 to 0.8."""


@dataclass(frozen=True, kw_only=True)
class GradeStiffness(Grader):
    """Let the porosity follow a map of target Young's moduli, by the structure's own curve of modulus over porosity.

    The curve comes from homogenized cells: those of a recipe, which are drawn and homogenized here; a CSV file, such as
    the `sweep.csv` of the configuration stiffness_map; or pairs of numbers. Cells of a recipe have more and fewer pores
    than it states, until they cover the range `porosities`; their modulus is that of the nearest isotropic material.
    Cells that scatter are averaged in groups, and the logarithm of the modulus goes monotonically through the means. A
    modulus beyond the curve is refused with its place. `check.local_porosity` then writes the modulus, too, that the
    measured porosity has by the curve.
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
    porosities: tuple[float, float] = option(
        (0.3, 0.8), help="range that the cells of a recipe cover", above=0, below=1
    )
    poisson: float = options.poisson(0.3, note="of the base material, for the cells of a recipe")
    trials: int = options.trials(3, note="of each number of pores, with a recipe")
    resolution: int = options.resolution(32, note="for homogenizing the cells of a recipe", minimum=8, maximum=128)

    def estimate(
        self, palette: Palette, grading: Size | None, part: Size | None, recipe: RecipeSize | None = None
    ) -> Size:
        if recipe is None:
            return Size()
        cells = TRIED * self.trials
        size: Size = self._homogenizer().solving(recipe(Palette(), cells), cells)
        return size

    def check_options(self) -> None:
        super().check_options()
        if self.path is not None and self.values:
            raise ConfigError("the curve is either a file, `path`, or pairs, `values`", hint="give one of them")
        if not self.porosities[0] < self.porosities[1]:
            raise ConfigError(f"`porosities` should rise, from {self.porosities[0]:g} to {self.porosities[1]:g}")
        if len(self.columns) != 2:
            raise ConfigError(f"`columns` names {len(self.columns)}; it takes two, porosity and modulus")
        if self.path is None and not self.values:
            self._homogenizer().check_options()

    def run(
        self, context: Context, grading: Grading | None, part: SurfaceMesh | None, recipe: Recipe | None = None
    ) -> Grading:
        """Homogenize the cells of the recipe, if there is one, and add the map to those made before."""
        given = sum((self.path is not None, bool(self.values), recipe is not None))
        if given != 1:
            raise ConfigError(
                "the curve is that of a file, `path`, of pairs, `values`, or of the cells of a `recipe`; "
                f"there {'is none' if not given else f'are {given}'}",
                hint="give one of them",
            )
        before = Grading() if grading is None else grading
        before.law(self.wanted)  # before any cell is homogenized
        return before.added(self._law(context, self._moduli_of(context, recipe) if recipe is not None else None))

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> StiffnessLaw:
        """The curve of a file or of pairs."""
        before.law(self.wanted)
        return self._law(context, None)

    def _homogenizer(self) -> Any:  # its `stiffness_of` is no part of the base class
        return stage_class("homogenize.voxel")(resolution=self.resolution, poisson=self.poisson)

    def cells_of(
        self, context: Context, recipe: Recipe, *, quiet: bool = False
    ) -> list[tuple[Microstructure, StiffnessReport]]:
        """Cells of a recipe with more and fewer pores, `trials` of each number, and their relative stiffness."""
        solving = cast(Context, Quiet(context)) if quiet else context
        homogenizer, found = self._homogenizer(), list[tuple[Microstructure, StiffnessReport]]()

        def porosity(count: int, attempt: int) -> float:
            cell = trial(context, recipe, count, attempt)
            found.append((cell, homogenizer.stiffness_of(solving, cell)))
            return float(found[-1][1].summary()["porosity"])

        curve_of(context, porosity, recipe_total(recipe), np.array(self.porosities), self.trials)
        return found

    def _moduli_of(self, context: Context, recipe: Recipe) -> F64:
        """Porosities and relative moduli (n, 2) of cells of a recipe."""
        found = [report.summary() for _, report in self.cells_of(context, recipe)]
        return np.array([(float(one["porosity"]), float(one["isotropic"]["E"])) for one in found])

    def _law(self, context: Context, cells: F64 | None) -> StiffnessLaw:
        """Fit the curve."""
        if cells is not None:
            where = "the recipe: "
        elif self.path is not None:
            from sppm_pipeline.services.formats.csv_columns import read_columns

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
