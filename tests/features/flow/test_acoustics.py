"""The model of Johnson, Champoux, Allard, Pride and Lafarge against straight cylindrical pores, and its limits."""

import numpy as np
import pytest
from scipy.special import jv

from sppm_pipeline.features.flow.acoustics import (
    THIRD_OCTAVES,
    PoreParameters,
    absorption,
    air,
    equivalent_fluid,
    third_octave,
)

AIR = air(20.0)
FREQUENCY = np.geomspace(50, 6400, 200)


def cylinders(porosity, radius):
    """Parameters of straight cylindrical pores."""
    k = porosity * radius**2 / 8
    return PoreParameters(porosity, k, k, 1.0, 4 / 3, 4 / 3, radius, radius)


def exact(porosity, radius, frequency):
    """Density and bulk modulus of air in them (Stinson 1991)."""
    omega = 2 * np.pi * frequency

    def part(s):
        x = s * np.sqrt(-1j)
        return 2 * jv(1, x) / (x * jv(0, x))

    s = radius * np.sqrt(omega * AIR.density / AIR.viscosity)
    prandtl = AIR.viscosity * AIR.heat_capacity / AIR.conductivity
    density = AIR.density / (1 - part(s)) / porosity
    modulus = AIR.heat_ratio * AIR.pressure / (1 + (AIR.heat_ratio - 1) * part(s * np.sqrt(prandtl))) / porosity
    return density, modulus


@pytest.mark.parametrize("radius", [50e-6, 200e-6, 1e-3])
@pytest.mark.parametrize("porosity", [0.3, 0.9])
def test_straight_cylindrical_pores(porosity, radius):
    for thickness in (0.02, 0.05):
        model = absorption(*equivalent_fluid(cylinders(porosity, radius), AIR, FREQUENCY), thickness, FREQUENCY, AIR)
        known = absorption(*exact(porosity, radius, FREQUENCY), thickness, FREQUENCY, AIR)
        assert abs(model[0] - known[0]).max() < 0.02
        assert ((model[0] >= 0) & (model[0] <= 1)).all()
        assert known[0].max() > 0.15


def test_limits():
    pores = cylinders(0.7, 2e-4)._replace(
        tortuosity=1.5, viscous_tortuosity=2.1, thermal_permeability=6e-9, thermal_length=4e-4, thermal_tortuosity=1.5
    )
    low, high = np.array([1e-2]), np.array([1e9])
    density, modulus = equivalent_fluid(pores, AIR, low)
    assert -density.imag * 2 * np.pi * low == pytest.approx(AIR.viscosity / pores.permeability, rel=1e-5)
    assert density.real == pytest.approx(AIR.density / 0.7 * 2.1, rel=1e-3)
    assert modulus.real == pytest.approx(AIR.pressure / 0.7, rel=1e-4)  # isothermal
    # of what rises with the frequency the thermal permeability is the slope
    rise = AIR.density * AIR.heat_capacity * 6e-9 / (0.7 * AIR.conductivity) * 2 * np.pi * low
    assert modulus.imag == pytest.approx(AIR.pressure / 0.7 * 0.4 / 1.4 * rise, rel=1e-3)
    density, modulus = equivalent_fluid(pores, AIR, high)
    skin = np.sqrt(2 * AIR.viscosity / (AIR.density * 2 * np.pi * high))
    assert density.real == pytest.approx(AIR.density * 1.5 / 0.7, rel=1e-3)
    assert -density.imag / density.real == pytest.approx(skin / 2e-4, rel=0.02)  # Lambda is the viscous length
    assert modulus.real == pytest.approx(AIR.heat_ratio * AIR.pressure / 0.7, rel=1e-3)  # adiabatic
    with pytest.raises(ValueError, match="static tortuosity"):
        equivalent_fluid(pores._replace(viscous_tortuosity=1.4), AIR, low)


def test_a_layer_of_air_absorbs_nothing():
    one = np.ones(3)
    frequency = np.array([100.0, 400.0, 900.0])
    density, modulus = one * AIR.density, one * AIR.heat_ratio * AIR.pressure
    share, impedance = absorption(density + 0j, modulus + 0j, 0.05, frequency, AIR)
    assert share == pytest.approx(0, abs=1e-12)
    c = np.sqrt(AIR.heat_ratio * AIR.pressure / AIR.density)
    assert c == pytest.approx(343.2, rel=1e-3)
    assert impedance.imag == pytest.approx(-AIR.impedance / np.tan(2 * np.pi * frequency / c * 0.05))


def test_bands():
    assert len(THIRD_OCTAVES) == 19
    for band in THIRD_OCTAVES:
        inside = third_octave(band)
        assert np.exp(np.log(inside).mean()) == pytest.approx(band, rel=0.02)
        assert inside.max() / inside.min() == pytest.approx(10 ** (0.1 * 11 / 12))
