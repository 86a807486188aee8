"""``tune.stiffness``: from a target Young's modulus back to the design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, Palette, Recipe, RecipeSize, ScalarField, Size, Tuner, option, options
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import ElasticHomogenizer


@dataclass(frozen=True, kw_only=True)
class TuneStiffness(ElasticHomogenizer, Tuner):
    """Find the structure whose Young's modulus is the target ("we can uniquely determine the structure at a target
    Young's modulus", paper, section 3.2).

    One option of the recipe is varied, the porosity that its `tune.porosity` or tile set aims at unless `vary` names
    another. A few values are homogenized first; a monotone curve through the logarithms of the moduli then proposes the
    next one, which is homogenized in turn, until the real modulus is within the tolerance of the target. All trials use
    the same random numbers, so that they differ by that option alone.

    The target is met on the grid of `resolution`; a last homogenization on a grid coarser by a third tells how far that
    is from the limit of fine grids: `modulus_grid_error` in the summary, with a warning if it exceeds `accuracy`.
    `tune.property` searches in the same way for any number that a stage of its recipe reports.
    """

    name: ClassVar[str] = "tune.stiffness"
    version: ClassVar[int] = 2
    reported: ClassVar[tuple[str, ...]] = (
        "value", "modulus", "modulus_error", "modulus_grid_error", "modulus_extrapolated", "homogenizations",
        "curve.#6.#2",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("modulus", error="modulus_grid_error"), Headline("modulus_extrapolated", "on fine grids"),
        Headline("value"), Headline("homogenizations"),
    )  # fmt: skip

    target: float = options.target(note="Young's modulus, in the unit of `young`", maximum=1e15)
    modulus: str = option(
        "isotropic", help="which modulus: of the nearest isotropic material, or along an axis",
        choices=("isotropic", "x", "y", "z"),
    )  # fmt: skip
    accuracy: float = options.accuracy(0.01, note="the modulus")
    evaluations: int = options.evaluations(20, note="cells homogenized")

    def check_options(self) -> None:
        super().check_options()
        self.check_range()

    def estimate(self, palette: Palette, recipe: RecipeSize) -> Size:
        """The first trials, and the two that usually follow; the porosity that is found is not known beforehand."""
        trials = self.first + 2
        made = recipe(palette, trials)
        # the grid coarser by a third, which tells the error, has 0.3 of the voxels
        return replace(self.solving(made, self.resolution, trials + 0.3), design=made.design)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Sample, propose, correct."""
        return self.met(
            context, recipe, self.target, self.accuracy,
            lambda made: self._modulus(context, made, self.resolution),
            what=("modulus", "modulus"), counted=("homogenizations", "homogenizations"),
            more=lambda modulus, made: self._grid_error(context, modulus, made),
        )  # fmt: skip

    def _modulus(self, context: Context, made: ScalarField, resolution: int) -> float:
        """The modulus that is tuned, of a field on a grid."""
        summary = replace(self, resolution=resolution).stiffness_of(context, made).summary()
        axis = "xyz".find(self.modulus)
        return float(summary["E"][axis] if axis >= 0 else summary["isotropic"]["E"])

    def _grid_error(self, context: Context, modulus: float, made: ScalarField) -> dict[str, float]:
        """What a grid coarser by a third tells of the result: error bar and limit of fine grids (Richardson)."""
        from sppm_pipeline.services.elastic.convergence import richardson

        coarse = max(2, round(self.resolution * 2 / 3))
        if coarse == self.resolution:
            return {}
        values = [np.array([self._modulus(context, made, coarse)]), np.array([modulus])]
        limit = richardson([1 / coarse, 1 / self.resolution], values)
        error, extrapolated = float(limit.error[0]), float(limit.value[0])
        if error > self.accuracy * self.target:
            context.warn(
                f"the modulus {modulus:.4g} is that of a grid of {self.resolution} voxels along the edge, whose error "
                f"bar is {error:.2g}, more than `accuracy` allows; finer grids tend to {extrapolated:.4g}: raise "
                "`resolution`"
            )
        return {"modulus_grid_error": error, "modulus_extrapolated": extrapolated}
