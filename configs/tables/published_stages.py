"""A stage that a table needs: the paper's numbers of compression beside the modulus of the same cell."""

from dataclasses import dataclass
from typing import ClassVar

from sppm_pipeline import ConfigError, Context, Stage, option
from sppm_pipeline.nouns import StiffnessReport

EDGE = 45.0
"""Of the paper's blocks, mm."""

PUBLISHED = {
    "tpms_p": (1.7765, 2.6396, 6.065), "tpms_l": (1.4936, 5.2674, 16.11), "kelvin": (1.6477, 2.3844, 8.357),
    "octet": (1.5488, 3.9342, 12.39), "et_1": (2.1695, 2.8259, 8.753), "et_2": (1.1789, 6.7259, 6.236),
    "sppm_1": (0.5452, 20.2926, 20.93), "sppm_2": (0.4433, 20.3177, 16.73),
}  # fmt: skip
"""Strength in MPa, displacement there in mm, and energy up to there in J: the paper's table 1."""


@dataclass(frozen=True, kw_only=True)
class MeasurePublished(Stage):
    """Set what the paper printed of a structure beside its modulus along z."""

    name: ClassVar[str] = "measure.published"
    reported: ClassVar[tuple[str, ...]] = ("strength", "strain", "secant", "modulus", "share", "fullness")

    structure: str = option(help="structure of the paper's table", choices=tuple(PUBLISHED))

    def run(self, context: Context, stiffness: StiffnessReport) -> None:
        if stiffness.unit != "MPa":
            raise ConfigError(f"the modulus is in {stiffness.unit}, and the paper's numbers in MPa")
        strength, displacement, energy = PUBLISHED[self.structure]
        strain, modulus = displacement / EDGE, float(stiffness.E[2])
        secant = strength / strain
        context.report(
            strength=strength, strain=strain, secant=secant, modulus=modulus, share=secant / modulus,
            fullness=1e3 * energy / EDGE**2 / (strength * displacement),
        )  # fmt: skip
