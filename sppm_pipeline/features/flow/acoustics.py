"""The sound that a layer of a porous structure absorbs.

Sound in the pores of a rigid material as an equivalent fluid, after Johnson, Champoux, Allard, Pride and Lafarge.

Eight numbers of the pores, all static, give density and bulk modulus of the fluid at any frequency: Johnson et al.
1987 and Champoux and Allard 1991 for short waves, Lafarge et al. 1997 and Pride et al. 1993 for long ones; as
collected by Allard and Atalla, "Propagation of Sound in Porous Media", 2009, ch. 5. Time goes as ``exp(j omega t)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sppm_pipeline import Report, number, reports
from sppm_pipeline.nouns import TEXT, Number


class Gas(NamedTuple):
    """Gas in the pores."""

    density: float  # kg / m^3
    viscosity: float  # Pa s
    conductivity: float  # of heat, W / (m K)
    heat_capacity: float  # at constant pressure, J / (kg K)
    heat_ratio: float  # that over the one at constant volume
    pressure: float  # Pa

    @property
    def impedance(self) -> float:
        """Of free plane waves, Pa s / m."""
        return float(np.sqrt(self.heat_ratio * self.pressure * self.density))


def air(celsius: float) -> Gas:
    """Dry air at normal pressure; viscosity and conductivity by Sutherland's law (White, "Viscous Fluid Flow")."""
    kelvin, pressure = celsius + 273.15, 101325.0
    viscosity = 1.716e-5 * (kelvin / 273.15) ** 1.5 * (273.15 + 110.6) / (kelvin + 110.6)
    conductivity = 0.0241 * (kelvin / 273.15) ** 1.5 * (273.15 + 194.4) / (kelvin + 194.4)
    return Gas(pressure / (287.05 * kelvin), viscosity, conductivity, 1006.0, 1.4, pressure)


class PoreParameters(NamedTuple):
    """Parameters of the model, in meters.

    Attributes
    ----------
    porosity : float
    permeability, thermal_permeability : float
        m^2.
    tortuosity : float
        In the limit of high frequencies.
    viscous_tortuosity, thermal_tortuosity : float
        Static ones.
    viscous_length, thermal_length : float
        Characteristic lengths Lambda and Lambda', m.
    """

    porosity: float
    permeability: float
    thermal_permeability: float
    tortuosity: float
    viscous_tortuosity: float
    thermal_tortuosity: float
    viscous_length: float
    thermal_length: float


def equivalent_fluid(
    pores: PoreParameters, gas: Gas, frequency: ArrayLike
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Density (kg / m^3) and bulk modulus (Pa) of the fluid for material and gas, at frequencies (n,) > 0 in Hz."""
    omega = 2 * np.pi * np.asarray(frequency, np.float64)
    phi, turns = pores.porosity, pores.tortuosity
    # viscous losses act on the density: dimensionless frequency w and shape factor M, with the viscous length Lambda
    w = omega * gas.density * pores.permeability * turns / (gas.viscosity * phi)
    m = 8 * turns * pores.permeability / (phi * pores.viscous_length**2)
    f = _relaxation(w, m, pores.viscous_tortuosity / turns)
    density = gas.density / phi * turns * (1 + f / (1j * w))
    # heat conduction acts on the compressibility: the same with thermal permeability and Lambda'
    w = omega * gas.density * gas.heat_capacity * pores.thermal_permeability / (gas.conductivity * phi)
    m = 8 * pores.thermal_permeability / (phi * pores.thermal_length**2)
    f = _relaxation(w, m, pores.thermal_tortuosity)
    gamma = gas.heat_ratio
    return density, gamma * gas.pressure / phi / (gamma - (gamma - 1) / (1 + f / (1j * w)))


def _relaxation(w: NDArray[np.float64], m: float, ratio: float) -> NDArray[Any]:
    """The function F of Pride's model; `ratio` is that of the static tortuosity over the one of short waves."""
    if ratio <= 1:
        raise ValueError(f"the static tortuosity is larger than that of short waves, got {ratio} times as large")
    # Pride's parameter: chosen so that the limit of low frequencies has the static tortuosity
    p = m / (4 * (ratio - 1))
    return np.asarray(1 - p + p * np.sqrt(1 + 1j * w * m / (2 * p * p)))


def absorption(
    density: NDArray[np.complex128], modulus: NDArray[np.complex128], thickness: float, frequency: ArrayLike, gas: Gas
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Absorption (n,), the share of the incoming energy that does not come back, of plane waves at normal incidence by
    a layer on a rigid wall, and the impedance of its surface (n,), pressure over velocity in Pa s / m.

    `density` and `modulus` (n,) are those of the equivalent fluid, `thickness` is in m, `frequency` (n,) in Hz, and
    `gas` is in front of the layer.
    """
    omega = 2 * np.pi * np.asarray(frequency, np.float64)
    wave = omega * np.sqrt(density / modulus)
    # a rigid wall reflects all: the impedance of the layer is -j Z cot(k d)
    impedance = -1j * np.sqrt(density * modulus) / np.tan(wave * thickness)
    back = (impedance - gas.impedance) / (impedance + gas.impedance)
    return 1 - np.abs(back) ** 2, impedance


THIRD_OCTAVES = (
    100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500, 3150, 4000, 5000, 6300,
)  # fmt: skip
"""Nominal middle frequencies, Hz (ISO 266)."""

NRC_BANDS = (250, 500, 1000, 2000)
"""Bands whose mean is the noise reduction coefficient (ASTM C423)."""

_INSIDE = 12
"""Frequencies of a band whose absorption is averaged: a heuristic, not sensitive, as curves are smooth in a band."""


def third_octave(nominal: int) -> NDArray[np.float64]:
    """Frequencies inside of a third-octave band, evenly spread on a logarithmic axis, Hz."""
    # exact middles are powers of 10^0.1 (base-ten bands of ISO 266), from which nominal ones are rounded
    number = round(10 * np.log10(nominal))
    return np.asarray(10 ** ((number + (np.arange(_INSIDE) + 0.5) / _INSIDE - 0.5) / 10))


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
        return PoreParameters(
            self.porosity, self.permeability, self.thermal_permeability, self.tortuosity, self.viscous_tortuosity,
            self.thermal_tortuosity, 1e-3 * self.viscous_length, 1e-3 * self.thermal_length,
        )  # fmt: skip

    def absorption(self, frequency: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """Absorption of the layer and the impedance of its surface (Pa s / m) at frequencies in Hz, both (n,)."""
        gas = air(self.temperature)
        density, modulus = equivalent_fluid(self.pores, gas, frequency)
        return absorption(density, modulus, 1e-3 * self.layer, frequency, gas)

    def bands(self) -> dict[int, float]:
        """Mean absorption of each third of an octave, by its nominal frequency in Hz."""
        return {band: float(self.absorption(third_octave(band))[0].mean()) for band in THIRD_OCTAVES}
