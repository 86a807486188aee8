"""``tune.plateau``: from a target plateau stress back to the design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sppm_crushing.crusher import Crusher
from sppm_crushing.crusher_options import least_strain
from sppm_pipeline import Context, Headline, Palette, Recipe, RecipeSize, ScalarField, Size, Tuner, option, options


@dataclass(frozen=True, kw_only=True)
class TunePlateau(Crusher, Tuner):
    """Find the block whose plateau stress is the target: the stress at which packaging or a damper yields.

    One option of the recipe is varied as by `tune.stiffness`, and each block is crushed as by `crush.voxel`, whose
    options it has. The plateau stress is the mean from 20 to 40 % strain. Start with few voxels and a fast plate.
    """

    name: ClassVar[str] = "tune.plateau"
    reported: ClassVar[tuple[str, ...]] = (
        "varied", "value", "plateau", "plateau_error", "work", "crushed", "unit", "curve.#6.#2",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("plateau", "plateau stress", "{unit}"), Headline("value"), Headline("crushed", "blocks crushed"),
    )  # fmt: skip

    strain: float = option(0.4, help="strain at the end", minimum=0.4, maximum=0.8)
    least_strain: float = least_strain(0.4, note="by every block", minimum=0.4)
    target: float = options.target(note="plateau stress, in the unit of `young`", maximum=1e15)
    accuracy: float = options.accuracy(0.05, note="the plateau stress")

    def check_options(self) -> None:
        super().check_options()
        self.check_range()

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        """The first trials, and the two that usually follow."""
        made = recipe(palette, self.first + 2)
        crushed = self.crushing(made)
        return replace(crushed, voxels=(self.first + 2) * crushed.voxels, result=made)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Crush, propose, correct."""
        works: dict[float, float] = {}

        def plateau(made: ScalarField) -> float:
            if not made.solid(2 * self.resolution, context.threads).any():
                return 0.0
            numbers = self.crush(context, made).numbers
            works[numbers["plateau"]] = numbers["work"]
            return max(0.0, float(numbers["plateau"]))

        return self.met(
            context, recipe, self.target, self.accuracy, plateau,
            what=("plateau", "plateau stress"), counted=("crushed", "blocks"),
            more=lambda number, made: {"work": works[number], "unit": self.stress_unit},
        )  # fmt: skip
