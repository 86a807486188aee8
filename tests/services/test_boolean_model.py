"""Expected porosity and area: exact cases of the Boolean model, and the area as what a thicker skin would add."""

from __future__ import annotations

import math

import pytest

from sppm_pipeline.services.boolean_model import (
    WIDENING,
    expected_structure,
    expected_walls,
    kernels_at_a_point,
    tunnel_length,
)


def test_balls_of_a_stated_porosity():
    """1 - exp(-V) is the porosity, and n balls of the volume V / n have the surface."""
    n, porosity = 40, 0.6
    radius = (-math.log(1 - porosity) / (n * 4 / 3 * math.pi)) ** (1 / 3)
    area = (1 - porosity) * n * 4 * math.pi * radius**2
    assert expected_structure(n, 0, 0.123, 0.05, porosity) == pytest.approx((porosity, area))


def test_tubes_of_a_stated_porosity():
    length, radius = tunnel_length(0), 0.1
    porosity = 1 - math.exp(-30 * math.pi * radius**2 * length)
    area = (1 - porosity) * 30 * 2 * math.pi * radius * length
    assert expected_structure(0, 30, 0.0, radius, porosity) == pytest.approx((porosity, area))


def test_the_sum_of_kernels_is_wider_than_its_parts():
    """The paper's cell: 66 pores and 158 tunnels, .40 of the parts and .69 of the sum in the comment of `WIDENING`."""
    assert expected_structure(0, 0, 0.1, 0.1) == (0.0, 0.0)
    volume = 20 * 4 / 3 * math.pi * 0.1**3 + 50 * math.pi * 0.03**2 * 0.85 / 20 ** (1 / 3)
    porosity, _ = expected_structure(20, 50, 0.1, 0.03)
    assert porosity == pytest.approx(1 - math.exp(-WIDENING * volume))
    assert pytest.approx(0.69 / 0.40, rel=0.02) == WIDENING


def test_kernels_at_a_point_are_the_volumes_within_reach():
    assert kernels_at_a_point(3, 0, 0.2, 9.0) == pytest.approx(3 * 4 / 3 * math.pi * 0.2**3)
    capsule = math.pi * 0.1**2 * 0.85 + 4 / 3 * math.pi * 0.1**3
    assert kernels_at_a_point(1, 5, 0.0, 0.1) == pytest.approx(5 * capsule)


def test_the_area_of_walls_is_what_half_their_thickness_takes_from_the_void():
    thin, thick = (expected_walls(0.25, half, 0.05, 0)[0] for half in (0.02 - 1e-6, 0.02 + 1e-6))
    porosity, area = expected_walls(0.25, 0.02, 0.05, 0)
    assert porosity == pytest.approx(math.exp(-2 * 0.02 * 2.9 / 0.25))
    assert area == pytest.approx((thin - thick) / 2e-6, rel=1e-6)
    half_open = 0.5 * 2.9 / (math.pi * 0.05**2 * 0.25)
    assert expected_walls(0.25, 0.02, 0.05, half_open)[0] == pytest.approx(math.exp(-0.02 * 2.9 / 0.25))
    assert expected_walls(0.25, 0.02, 0.05, 1e9)[0] == pytest.approx(math.exp(-2 * 0.02 * 0.29 / 0.25))
