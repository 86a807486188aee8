"""``measure.compression``: plateau, energy absorption and the other numbers of a curve of compression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from sppm_crushing.compression import CompressionCurve
from sppm_crushing.numerics.compression import Measure, Specimen, measures, work_ratio
from sppm_pipeline import ConfigError, Context, DesignError, Headline, Palette, Size, Stage, Table, option


def plateau_window() -> Any:
    """The declaration of the option `plateau`."""
    return option((0.2, 0.4), help="strains between which the plateau stress is taken", minimum=0, maximum=1)


def energy_end() -> Any:
    """The declaration of the option `energy_to`."""
    return option(0.5, help="strain up to which energy is taken", minimum=0.01, maximum=1)


NUMBERS = (
    "plateau_stress", "plateau_end", "energy_to_strain", "energy_efficiency_to_strain", "energy_to_plateau_end",
    "energy_efficiency_to_plateau_end", "energy_25", "energy_40", "first_maximum", "first_maximum_strain", "gradient",
    "elastic_gradient", "offset_stress", "proof_strength", "densification_strain", "efficiency_max",
    "energy_to_densification", "energy_per_mass", "stress_10", "compressive_strength", "yield_strength",
    "effective_displacement", "effective_energy",
)  # fmt: skip
"""Names of all measures."""


@dataclass(frozen=True, kw_only=True)
class MeasureCompression(Stage):
    """Measure a curve of compression, tested or simulated: plateau stress, energies, gradients, densification.

    The table has a row for each measure with the definition that it was computed by and where that is from, or the
    reason why the curve has none. Stress and strain are nominal. The definitions follow ISO 13314 and ISO 844 as they
    are known from the literature, Li et al. 2006, and section 3.3 of the paper.
    """

    name: ClassVar[str] = "measure.compression"
    reported: ClassVar[tuple[str, ...]] = (*NUMBERS, "unit", "name", "origin", "without.*", "published.*")
    headline: ClassVar[tuple[Headline, ...]] = (
        Headline("plateau_stress", "plateau stress", "{unit}"),
        Headline("energy_to_strain", "energy per volume", "{unit}"),
        Headline("densification_strain", "densification strain"),
        Headline("gradient", "gradient", "{unit}"),
    )

    plateau: tuple[float, float] = plateau_window()
    energy_to: float = energy_end()
    published: tuple[float, float, float] | None = option(
        None,
        help="yield strength (MPa), effective displacement (mm) and energy (J) that a paper states of this specimen; "
        "flagged if the energy is more than force times displacement", minimum=1e-9, maximum=1e9,
    )  # fmt: skip

    def check_options(self) -> None:
        """A plateau with a beginning and an end."""
        check_plateau(self.plateau)

    def estimate(self, palette: Palette, curve: Size) -> Size:
        return Size()

    def run(self, context: Context, curve: CompressionCurve) -> Table:
        """Measure."""
        found = measured(curve, self.plateau, self.energy_to)
        context.report(
            **{one.name: one.value for one in found}, unit=curve.unit, name=curve.name, origin=curve.origin,
            without={one.name: one.remark for one in found if one.value is None},
        )  # fmt: skip
        if self.published is not None:
            context.report(published=self._judged(context, curve))
        return Table({
            "measure": tuple(one.label for one in found), "value": tuple(one.value for one in found),
            "unit": tuple(one.unit for one in found), "definition": tuple(one.definition for one in found),
            "source": tuple(one.source for one in found), "remark": tuple(one.remark for one in found),
        })  # fmt: skip

    def _judged(self, context: Context, curve: CompressionCurve) -> dict[str, float]:
        """The published numbers, and their energy over force times displacement."""
        assert self.published is not None
        if curve.area is None:
            raise ConfigError("`published` needs the area of the specimen", hint="give its size in `read.compression`")
        strength, way, energy = self.published
        ratio = work_ratio(energy, strength, curve.area, way)
        if ratio > 1:
            context.warn(
                f"the published energy of {curve.name or 'the specimen'}, {energy:g} J, is {ratio:.3f} times its "
                f"highest force times its displacement ({strength:g} MPa over {curve.area:g} mm2, {way:g} mm): "
                "impossible, as the force is nowhere higher"
            )
        return {"yield_strength": strength, "effective_displacement": way, "effective_energy": energy, "ratio": ratio}


def check_plateau(plateau: tuple[float, float]) -> None:
    """Raise `ConfigError` if a plateau ends before it begins."""
    if not plateau[0] < plateau[1]:
        raise ConfigError(
            f"`plateau` goes from {plateau[0]:g} to {plateau[1]:g}", hint="write the smaller strain first"
        )


def measured(curve: CompressionCurve, plateau: tuple[float, float], energy_to: float) -> list[Measure]:
    """All measures of a curve; `DesignError` if it is no curve of compression."""
    specimen = Specimen(curve.unit, curve.area, curve.height, curve.density, curve.ended)
    try:
        return measures(curve.strain, curve.stress, specimen, plateau=plateau, energy_to=energy_to)
    except ValueError as error:
        raise DesignError(f"{curve.name or 'the curve'} can't be measured: {error}") from error
