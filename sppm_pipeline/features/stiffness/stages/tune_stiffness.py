"""``tune.stiffness``: from a target Young's modulus back to the design."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

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

    The modulus is that of fine grids, extrapolated as by `homogenize.voxel`; its error bar is `modulus_grid_error` in
    the summary, with a warning if it exceeds `accuracy`.
    `tune.property` searches in the same way for any number that a stage of its recipe reports.
    """

    name: ClassVar[str] = "tune.stiffness"
    version: ClassVar[int] = 4
    reported: ClassVar[tuple[str, ...]] = (
        "value", "modulus", "modulus_error", "modulus_grid_error", "homogenizations", "curve.#6.#2",
    )  # fmt: skip
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("modulus", error="modulus_grid_error"), Headline("value"), Headline("homogenizations"),
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
        trials = self.first + 2  # two usually follow the first
        made = recipe(palette, trials)
        return replace(self.solving(made, trials), result=made)

    def run(self, context: Context, recipe: Recipe) -> Any:
        """Sample, propose, correct."""
        errors: dict[float, float | None] = {}

        def modulus_of(made: ScalarField) -> float:
            summary = self.stiffness_of(context, made).summary()
            axis = "xyz".find(self.modulus)
            modulus = float(summary["E"][axis] if axis >= 0 else summary["isotropic"]["E"])
            if "E_error" in summary:
                relative = summary["E_relative_error"] / summary["E_relative"] if modulus else 0.0
                errors[modulus] = float(summary["E_error"][axis]) if axis >= 0 else relative * modulus
            return modulus

        return self.met(
            context, recipe, self.target, self.accuracy, modulus_of,
            what=("modulus", "modulus"), counted=("homogenizations", "homogenizations"),
            more=lambda modulus, made: self._grid_error(context, modulus, errors.get(modulus)),
        )  # fmt: skip

    def _grid_error(self, context: Context, modulus: float, error: float | None) -> dict[str, float]:
        """Error bar of the result."""
        if error is None:
            return {}
        if error > self.accuracy * self.target:
            context.warn(
                f"the modulus {modulus:.4g} has an error bar of {error:.2g} on {self.resolution} voxels along the "
                "edge, more than `accuracy` allows: raise `resolution`"
            )
        return {"modulus_grid_error": error}
