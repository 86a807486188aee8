import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.kernels import splat
from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, empty_kernels, reach_boxes
from sppm_pipeline.method.kernels.profiles import (
    TUNNEL_PROFILES,
    TunnelProfile,
    omega_from_radius,
)
from sppm_pipeline.services.grid import Grid, cell_centers
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum

LINEAR, SQUARED = TUNNEL_PROFILES["linear"], TUNNEL_PROFILES["squared"]
profiles = st.sampled_from([*TUNNEL_PROFILES.values(), TunnelProfile("cubed", 3, abs)])
radii = st.floats(1e-3, 1e3)
levels = st.floats(0.01, 0.99)


def test_paper_values() -> None:
    # omega = mu = 30, C = 0.25: radii in the unit of the paper.
    assert SQUARED.radius(30.0, 0.25) == pytest.approx(0.21496, abs=1e-5)
    assert LINEAR.radius(30.0, 0.25) == pytest.approx(0.046210, abs=1e-6)


@given(radii, levels, profiles)
def test_there_and_back(radius: float, level: float, profile: TunnelProfile) -> None:
    assert SQUARED.radius(omega_from_radius(radius, level), level) == pytest.approx(radius)
    assert profile.radius(profile.mu(radius, level), level) == pytest.approx(radius)


@given(radii, levels, profiles, st.floats(0.1, 100.0))
def test_cell_units_scale_lengths(radius: float, level: float, profile: TunnelProfile, edge: float) -> None:
    mu = profile.in_cell_units(profile.mu(radius, level), edge)
    assert profile.radius(mu, level) * edge == pytest.approx(radius)


@given(radii, levels, profiles)
def test_kernel_has_the_level_at_its_radius(radius: float, level: float, profile: TunnelProfile) -> None:
    assert math.exp(-omega_from_radius(radius, level) * radius**2) == pytest.approx(level)
    assert math.exp(-profile.mu(radius, level) * radius**profile.power) == pytest.approx(level)
    assert profile.value(profile.mu(radius, level), np.array(radius**2)) == pytest.approx(level)


@given(st.floats(1.0, 1e4), st.sampled_from([1e-9, 1e-5, 1e-2]), profiles)
def test_scaled_lengths_reach_equally_far(mu: float, cutoff: float, profile: TunnelProfile) -> None:
    assert profile.scale(mu) * profile.reach(mu, cutoff) == pytest.approx(profile.scaled_reach(cutoff))
    radius = profile.radius(mu, 0.3)
    assert profile.radius(mu * profile.scaled_radius(np.float64(1.7)), 0.3) == pytest.approx(1.7 * radius)


@pytest.mark.parametrize("level", [0.0, 1.0, -0.2, 1.5, math.nan])
def test_bad_level(level: float) -> None:
    with pytest.raises(DesignError, match="level"):
        omega_from_radius(0.1, level)
    with pytest.raises(DesignError, match="level"):
        LINEAR.radius(30.0, level)


@pytest.mark.parametrize("value", [0.0, -1.0, math.inf, math.nan])
def test_bad_lengths_and_parameters(value: float) -> None:
    for call in (
        lambda: omega_from_radius(value, 0.25),
        lambda: LINEAR.mu(value, 0.25),
        lambda: LINEAR.radius(value, 0.25),
        lambda: LINEAR.in_cell_units(30.0, value),
        lambda: LINEAR.in_cell_units(value, 2.0),
    ):
        with pytest.raises(DesignError, match="positive, finite"):
            call()


def test_reach_is_where_the_kernel_meets_the_cutoff() -> None:
    omega, mu = np.array([30.0, 120.0]), np.array([30.0, 60.0])
    assert np.exp(-omega * SQUARED.reach(omega, 1e-5) ** 2) == pytest.approx(1e-5)
    assert np.exp(-mu * LINEAR.reach(mu, 1e-5)) == pytest.approx(1e-5)
    assert np.exp(-mu * SQUARED.reach(mu, 1e-5) ** 2) == pytest.approx(1e-5)


def test_reach_boxes() -> None:
    kernels = Kernels(
        np.array([[0.5, 0.5, 0.5]]),
        np.array([120.0]),
        np.array([[0.1, 0.9, 0.4]]),
        np.array([[0.3, 0.2, 0.4]]),
        np.array([60.0]),
    )
    pore, tunnel = SQUARED.reach(120.0, 1e-3), LINEAR.reach(60.0, 1e-3)
    pore_lower, pore_upper, tunnel_lower, tunnel_upper = reach_boxes(kernels, 1e-3)
    assert pore_lower == pytest.approx(np.full((1, 3), 0.5 - pore))
    assert pore_upper == pytest.approx(np.full((1, 3), 0.5 + pore))
    assert tunnel_lower == pytest.approx(np.array([[0.1, 0.2, 0.4]]) - tunnel)
    assert tunnel_upper == pytest.approx(np.array([[0.3, 0.9, 0.4]]) + tunnel)
    assert all(len(box) == 0 for box in reach_boxes(empty_kernels()))


def test_two_profiles_do_not_mix_but_sets_without_tunnels_fit_any() -> None:
    one = empty_kernels()._replace(starts=np.zeros((1, 3)), ends=np.ones((1, 3)), mu=np.ones(1), profile="squared")
    assert concatenated([empty_kernels(), one, empty_kernels()]).profile == "squared"
    with pytest.raises(ValueError, match="one tunnel profile, not linear and squared"):
        concatenated([one, one._replace(profile="linear")])


def _fourth_power(squared_distance: np.float32) -> np.float32:
    return squared_distance * squared_distance


def test_a_third_profile_is_one_entry(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TUNNEL_PROFILES, "quartic", TunnelProfile("quartic", 4, _fourth_power))
    rng = np.random.default_rng(11)
    starts = rng.random((12, 3))
    mu = np.array([TUNNEL_PROFILES["quartic"].mu(0.06, 0.25)] * 12)
    pores = rng.random((8, 3))
    kernels = Kernels(pores, np.full(8, 90.0), starts, starts + rng.normal(size=(12, 3)) * 0.3, mu, "quartic")
    grid = Grid((0.01, 0.03, 0.02), (0.021, 0.033, 0.04), (45, 28, 22))
    for samples in (grid, cell_centers(32)):
        out = np.zeros(samples.shape[::-1], np.float32)
        splat.add_kernels(out, samples, kernels)
        z, y, x = np.meshgrid(*(samples.axis(a) for a in (2, 1, 0)), indexing="ij")
        points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        error = np.abs(out.ravel() - exact_sum(kernels, points))
        assert out.max() > 1.0
        assert error.max() <= cutoff_bound(kernels, points.min(axis=0), points.max(axis=0))


def test_each_profile_is_compiled_under_a_name_of_its_own() -> None:
    names = {splat.tunnel_adder(profile).py_func.__qualname__ for profile in TUNNEL_PROFILES.values()}
    assert len(names) == len(TUNNEL_PROFILES)
    other = TunnelProfile("linear", 1, _fourth_power)
    assert splat.tunnel_adder(other).py_func.__qualname__ not in names
