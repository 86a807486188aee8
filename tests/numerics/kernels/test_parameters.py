import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.numerics.kernels.kernels import Kernels, empty_kernels
from sppm_pipeline.numerics.kernels.parameters import (
    check_cutoff,
    mu_from_radius,
    mu_in_cell_units,
    omega_from_radius,
    omega_in_cell_units,
    pore_radius,
    pore_reach,
    reach_boxes,
    tunnel_radius,
    tunnel_reach,
)

radii = st.floats(1e-3, 1e3)
levels = st.floats(0.01, 0.99)


def test_paper_values() -> None:
    # omega = mu = 30, C = 0.25: radii in the unit of the paper.
    assert pore_radius(30.0, 0.25) == pytest.approx(0.21496, abs=1e-5)
    assert tunnel_radius(30.0, 0.25) == pytest.approx(0.046210, abs=1e-6)
    assert tunnel_radius(30.0, 0.25, squared=True) == pytest.approx(pore_radius(30.0, 0.25))


@given(radii, levels, st.booleans())
def test_there_and_back(radius: float, level: float, squared: bool) -> None:
    assert pore_radius(omega_from_radius(radius, level), level) == pytest.approx(radius)
    assert tunnel_radius(mu_from_radius(radius, level, squared), level, squared) == pytest.approx(radius)


@given(radii, levels, st.booleans(), st.floats(0.1, 100.0))
def test_cell_units_scale_lengths(radius: float, level: float, squared: bool, edge: float) -> None:
    omega = omega_in_cell_units(omega_from_radius(radius, level), edge)
    assert pore_radius(omega, level) * edge == pytest.approx(radius)
    mu = mu_in_cell_units(mu_from_radius(radius, level, squared), edge, squared)
    assert tunnel_radius(mu, level, squared) * edge == pytest.approx(radius)


@given(radii, levels)
def test_kernel_has_the_level_at_its_radius(radius: float, level: float) -> None:
    assert math.exp(-omega_from_radius(radius, level) * radius**2) == pytest.approx(level)
    assert math.exp(-mu_from_radius(radius, level) * radius) == pytest.approx(level)


@pytest.mark.parametrize("level", [0.0, 1.0, -0.2, 1.5, math.nan])
def test_bad_level(level: float) -> None:
    with pytest.raises(DesignError, match="level"):
        omega_from_radius(0.1, level)
    with pytest.raises(DesignError, match="level"):
        tunnel_radius(30.0, level)


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_bad_lengths_and_parameters(value: float) -> None:
    for call in (
        lambda: omega_from_radius(value, 0.25),
        lambda: mu_from_radius(value, 0.25),
        lambda: pore_radius(value, 0.25),
        lambda: tunnel_radius(value, 0.25),
        lambda: omega_in_cell_units(30.0, value),
        lambda: mu_in_cell_units(value, 2.0),
    ):
        with pytest.raises(DesignError, match="positive, finite"):
            call()


def test_reach_is_where_the_kernel_meets_the_cutoff() -> None:
    omega, mu = np.array([30.0, 120.0]), np.array([30.0, 60.0])
    assert np.exp(-omega * pore_reach(omega, 1e-5) ** 2) == pytest.approx(1e-5)
    assert np.exp(-mu * tunnel_reach(mu, 1e-5)) == pytest.approx(1e-5)
    assert np.exp(-mu * tunnel_reach(mu, 1e-5, squared=True) ** 2) == pytest.approx(1e-5)


def test_reach_boxes() -> None:
    kernels = Kernels(
        np.array([[0.5, 0.5, 0.5]]),
        np.array([120.0]),
        np.array([[0.1, 0.9, 0.4]]),
        np.array([[0.3, 0.2, 0.4]]),
        np.array([60.0]),
        False,
    )
    pore, tunnel = pore_reach(120.0, 1e-3), tunnel_reach(60.0, 1e-3)
    pore_lower, pore_upper, tunnel_lower, tunnel_upper = reach_boxes(kernels, 1e-3)
    assert pore_lower == pytest.approx(np.full((1, 3), 0.5 - pore))
    assert pore_upper == pytest.approx(np.full((1, 3), 0.5 + pore))
    assert tunnel_lower == pytest.approx(np.array([[0.1, 0.2, 0.4]]) - tunnel)
    assert tunnel_upper == pytest.approx(np.array([[0.3, 0.9, 0.4]]) + tunnel)
    assert all(len(box) == 0 for box in reach_boxes(empty_kernels()))


@pytest.mark.parametrize("cutoff", [0.0, 1e-13, 0.6, math.nan])
def test_bad_cutoff(cutoff: float) -> None:
    with pytest.raises(ValueError, match="cut-off"):
        check_cutoff(cutoff)
