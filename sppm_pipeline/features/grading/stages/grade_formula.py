"""``grade.formula``: a parameter given by a formula of place and of other maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import ConfigError, Context, SurfaceMesh, option
from sppm_pipeline.features.grading.grader import RESERVED, Grader
from sppm_pipeline.features.grading.laws import DistanceLaw, FormulaLaw
from sppm_pipeline.method.nouns.maps import (
    BOX_COORDINATES,
    CELL_COORDINATES,
    COORDINATES,
    DISTANCE,
    Grading,
)
from sppm_pipeline.services.expression import Expression, names_in

PLACES = (*COORDINATES, *BOX_COORDINATES, *CELL_COORDINATES, DISTANCE)


@dataclass(frozen=True, kw_only=True)
class GradeFormula(Grader):
    """Let a parameter follow a formula, for instance ``clip(0.8 - 0.02*x, 0.3, 0.75)``.

    Names: x, y, z in mm; u, v, w, which go from 0 to 1 through the box of the part; distance from its surface in mm,
    positive inside; cell_x, cell_y, cell_z, counted in cells; pi; the maps made before by other `grade` stages; and
    `constants`. Operators: + - * / ** %, comparisons,
    ``and``, ``or``, ``not``, ``a if test else b``. Functions: sin, cos, tan, exp, log, sqrt, abs, floor, tanh,
    atan2(y, x), hypot, min, max, clip(x, low, high), where(test, a, b), step(edge, x), smoothstep(low, high, x),
    mix(a, b, t). Truth is 1. A formula has at most 1000 characters.
    """

    name: ClassVar[str] = "grade.formula"

    formula: str = option(help="the value as a formula of place and of earlier maps")
    constants: tuple[tuple[str, float], ...] = option(
        (), help="names with values that the formula may use, as [[a, 0.5], [b, 3]]", minimum=-1e15, maximum=1e15
    )

    def check_options(self) -> None:
        super().check_options()
        names = [name for name, _ in self.constants]
        for name in names:
            if not name.isidentifier() or not name.isascii() or name in RESERVED or names.count(name) > 1:
                raise ConfigError(f"`constants`: {name[:40]!r} is no name that is free", hint="use letters, digits, _")
        # what names there are shows later; all others that the text holds are taken to be maps
        Expression(self.formula, {*names_in(self.formula) - RESERVED, *PLACES})

    def law(self, context: Context, before: Grading, part: SurfaceMesh | None) -> FormulaLaw:
        """The compiled formula."""
        box = None if part is None else np.array([part.lower, part.upper])
        clash = [name for name, _ in self.constants if name in before]
        if clash:
            raise ConfigError(f"`constants`: {clash[0]!r} is a map, too", hint="give another name")
        surface = None
        if part is not None and DISTANCE in names_in(self.formula):
            from sppm_pipeline.features.grading.stages.grade_distance import surface_of

            surface = DistanceLaw(DISTANCE, "mm", *surface_of(part))
        law = FormulaLaw(self.of, self.unit_of_values, self.formula, before.names, self.constants, box, surface)
        used = law.expression.used
        if box is not None and not (box[1] > box[0]).all() and set(used) & set(BOX_COORDINATES):
            raise ConfigError("the part is flat, so u, v, w are not defined", hint="use x, y, z")
        return law
