"""``homogenize.my_word``: the stiffness that the density alone lets expect."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sppm_pipeline import Context, Headline, ScalarField, Stage, Voxels, option, options
from sppm_pipeline.nouns import StiffnessReport


@dataclass(frozen=True, kw_only=True)
class DensityLaw(Stage):
    """Multiply the stiffness of the solid by ``prefactor * density^exponent``, the law of Gibson and Ashby for foams.

    It does not model the structure; what a solver finds above or below it is what the structure does.
    """

    name: ClassVar[str] = "homogenize.my_word"
    headline: ClassVar[tuple[Headline, ...]] = (Headline("E"), Headline("porosity"))

    prefactor: float = option(1.0, help="of the law; 1: a solid without pores is what it is", above=0, maximum=1)
    exponent: float = option(
        2.0, help="of the density; 1: walls under stretch, 2: struts that bend", minimum=1, maximum=9
    )
    young: float = options.young(1.0, note="1: results are relative to it")
    poisson: float = options.poisson(0.3)
    resolution: int = options.resolution(48, note="of fields; images keep theirs")

    def run(self, context: Context, source: ScalarField | Voxels) -> StiffnessReport:
        """Measure the density and apply the law."""
        if isinstance(source, Voxels):
            density = float(np.mean(source.values if source.fractions else source.values > 0, dtype=np.float64))
        else:
            density = float(np.mean(source.solid(self.resolution, context.threads)))
        shear = self.young / (2 * (1 + self.poisson))
        matrix = np.diag([2 * shear] * 3 + [shear] * 3)  # Voigt order xx, yy, zz, yz, xz, xy
        matrix[:3, :3] += 2 * shear * self.poisson / (1 - 2 * self.poisson)
        phases = ((density, self.young, self.poisson), (1 - density, 0.0, 0.0))
        return StiffnessReport(self.prefactor * density**self.exponent * matrix, phases, "Gibson and Ashby's law")
