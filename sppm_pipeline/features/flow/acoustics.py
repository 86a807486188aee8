"""The sound that a layer of a porous structure absorbs."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline import Report, number, reports
from sppm_pipeline.nouns import TEXT, Number

if TYPE_CHECKING:
    from sppm_pipeline.features.flow.numerics.acoustics import PoreParameters


@dataclass(frozen=True, eq=False)
class AcousticReport(Report):
    """Parameters of the pores after Johnson, Champoux, Allard, Pride and Lafarge along one axis, and of a layer.

    Attributes
    ----------
    axis : {"x", "y", "z"}
        Along which the sound comes.
    porosity : float
        Fraction of void that is open.
    permeability : float
        Along the axis, m^2.
    thermal_permeability : float
        m^2.
    tortuosity : float
        In the limit of high frequencies: porosity over relative conductivity of the void.
    viscous_tortuosity, thermal_tortuosity : float
        Static ones.
    viscous_length, thermal_length : float
        Characteristic lengths, mm: of the narrow places, where the fluid is fast, and twice volume over wall area.
    layer : float
        Thickness of the layer, which lies on a rigid wall, mm.
    temperature : float
        Of the air, degrees Celsius.
    edge_mm : float
        Edge of the cell.
    grid : (nx, ny, nz)
    warnings : tuple of str
    """

    headline: ClassVar[tuple[str, ...]] = (
        "nrc", "peak", "peak_frequency", "resistivity", "tortuosity", "porosity",
    )  # fmt: skip

    axis: str = field(metadata=TEXT)
    porosity: float = field(metadata=number())

    @property
    @reports(unit="Pa s/m^2")
    def resistivity(self) -> float:
        """Static flow resistivity, Pa s / m^2."""
        from sppm_pipeline.features.flow.numerics.acoustics import air

        return air(self.temperature).viscosity / self.permeability

    permeability: float = field(metadata=number())
    thermal_permeability: float = field(metadata=number())
    tortuosity: float = field(metadata=number())
    viscous_tortuosity: float = field(metadata=number())
    thermal_tortuosity: float = field(metadata=number())
    viscous_length: float = field(metadata=number())
    thermal_length: float = field(metadata=number())

    @property
    @reports()
    def shape(self) -> float:
        """Pore shape factor: near 1, exactly for straight cylindrical pores."""
        # M of Allard and Atalla, ch. 5: 8 alpha k / (phi Lambda^2)
        return 8 * self.tortuosity * self.permeability / (self.porosity * (1e-3 * self.viscous_length) ** 2)

    layer: float = field(metadata=number())
    temperature: float = field(metadata=number())

    @property
    @reports(label="NRC")
    def nrc(self) -> float:
        """Noise reduction coefficient, of normal incidence, in steps of 0.05."""
        from sppm_pipeline.features.flow.numerics.acoustics import NRC_BANDS

        bands = self.bands()
        # ASTM C423 rounds to multiples of 0.05; the outer rounding removes what the product adds in binary
        return round(round(float(np.mean([bands[band] for band in NRC_BANDS])) / 0.05) * 0.05, 2)

    @reports(Number("peak", label="largest absorption"), Number("peak_frequency", label="at", unit="Hz"))
    def _peak(self) -> tuple[float, float]:
        frequency = np.geomspace(50, 6300, 400)
        curve = self.absorption(frequency)[0]
        return float(curve.max()), float(frequency[curve.argmax()])

    @reports("absorption.#19", "absorption_at.*")
    def _by_third_octaves(self) -> tuple[list[float], dict[str, float]]:
        bands = self.bands()
        return list(bands.values()), {str(band): value for band, value in bands.items()}

    edge_mm: float = field(metadata=number())
    grid: tuple[int, int, int] = field(metadata=number("#3"))
    warnings: tuple[str, ...] = field(default=(), metadata=TEXT)

    def check(self) -> None:
        """Positive numbers, within the bounds that hold for any pores."""
        numbers = (self.permeability, self.thermal_permeability, self.viscous_length, self.thermal_length, self.layer)
        if not all(0 < number < math.inf for number in numbers):
            raise ValueError(f"permeabilities and lengths are finite and above 0, got {numbers}")
        if not 0 < self.porosity <= 1 or not 1 <= self.tortuosity < math.inf:
            raise ValueError(f"there is no porosity {self.porosity} with a tortuosity of {self.tortuosity}")
        # otherwise the relaxation function of Pride's model has no positive parameter p
        if self.viscous_tortuosity < self.tortuosity or self.thermal_tortuosity < 1:
            raise ValueError("static tortuosities are not below those of high frequencies")

    @property
    def pores(self) -> PoreParameters:
        """The parameters in meters."""
        from sppm_pipeline.features.flow.numerics.acoustics import PoreParameters

        return PoreParameters(
            self.porosity, self.permeability, self.thermal_permeability, self.tortuosity, self.viscous_tortuosity,
            self.thermal_tortuosity, 1e-3 * self.viscous_length, 1e-3 * self.thermal_length,
        )  # fmt: skip

    def absorption(self, frequency: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """Absorption of the layer and the impedance of its surface (Pa s / m) at frequencies in Hz, both (n,)."""
        from sppm_pipeline.features.flow.numerics.acoustics import absorption, air, equivalent_fluid

        gas = air(self.temperature)
        density, modulus = equivalent_fluid(self.pores, gas, frequency)
        return absorption(density, modulus, 1e-3 * self.layer, frequency, gas)

    def bands(self) -> dict[int, float]:
        """Mean absorption of each third of an octave, by its nominal frequency in Hz."""
        from sppm_pipeline.features.flow.numerics.acoustics import THIRD_OCTAVES, third_octave

        return {band: float(self.absorption(third_octave(band))[0].mean()) for band in THIRD_OCTAVES}
