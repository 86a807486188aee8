"""Solid fractions: exact for planes, within the stated error for a ball, periodic, independent of slabs."""

import numpy as np
import pytest

from sppm_pipeline.method.porosity.fractions import below_plane, solid_fractions


def sampled(field):
    """A field as a function of arrays x, y, z."""

    def layers(grid, start, stop):
        x, y, z = (grid.axis(a) for a in range(3))
        z = z[start:stop]
        return field(x, y[:, None], z[:, None, None]).astype(np.float32) + np.zeros((len(z), len(y), len(x)), "f4")

    return layers


@pytest.mark.parametrize("seed", range(6))
def test_a_plane_is_exact(seed):
    rng = np.random.default_rng(seed)
    slope = rng.standard_normal(3) * (rng.random(3) < 0.7)
    value = rng.normal() * 0.3
    x = (np.arange(100) + 0.5) / 100 - 0.5
    inside = value + slope[0] * x + slope[1] * x[:, None] + slope[2] * x[:, None, None] < 0
    assert below_plane(value, *slope) == pytest.approx(inside.mean(), abs=2e-3)


@pytest.mark.parametrize("value", [-2.0, 2.0])
def test_far_from_the_plane(value):
    assert below_plane(value, 1.0, 0.5, 0.2) == (value < 0)
    assert below_plane(value, 0.0, 0.0, 0.0) == (value < 0)


def test_a_layer_between_samples():
    share = solid_fractions(sampled(lambda x, y, z: np.abs(x - 0.5) - 0.2187), (8, 3, 2), 8)
    assert share[:, :, 0].max() == 0
    assert share.mean() * 8 / 8 == pytest.approx(2 * 0.2187, abs=1e-4)
    assert np.ptp(share, axis=(0, 1)).max() == 0


def test_a_ball():
    n, radius = 16, 0.25
    ball = sampled(lambda x, y, z: (x - 0.51) ** 2 + (y - 0.48) ** 2 + (z - 0.5) ** 2 - radius**2)
    share = solid_fractions(ball, (n, n, n), n)
    fine, parts = np.zeros((n, n, n)), 12
    x = (np.arange(n * parts) + 0.5) / (n * parts)
    inside = (x - 0.51) ** 2 + ((x - 0.48) ** 2)[:, None] + ((x - 0.5) ** 2)[:, None, None] < radius**2
    fine = inside.reshape(n, parts, n, parts, n, parts).mean((1, 3, 5))
    assert np.abs(share - fine).max() < 0.02
    assert share.mean() == pytest.approx(4 / 3 * np.pi * radius**3, rel=1e-3)


def test_the_error_is_of_second_order():
    def gyroid(x, y, z):
        x, y, z = (2 * np.pi * v for v in (x, y, z))
        return np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) - 0.6

    volumes = [float(solid_fractions(sampled(gyroid), (n,) * 3, n).mean(dtype=float)) for n in (6, 12, 24, 48)]
    errors = np.abs(np.diff(volumes))
    assert errors[1] / errors[2] > 3


def test_cells_and_slabs():
    """Voxels count from the origin; more layers than one slab holds."""

    def wave(x, y, z):
        return np.sin(2 * np.pi * x) + np.cos(2 * np.pi * y) + np.sin(2 * np.pi * z + 1)

    share = solid_fractions(sampled(wave), (16, 8, 40), 8)
    assert share.shape == (40, 8, 16)
    assert share[8:16] == pytest.approx(share[:8], abs=1e-5)
    assert share[24:32] == pytest.approx(share[:8], abs=1e-5)
    assert share[:, :, 8:] == pytest.approx(share[:, :, :8], abs=1e-5)


def test_walls_move_by_the_same_distance_everywhere():
    n, radius, step = 16, 0.3, 0.4
    ball = sampled(lambda x, y, z: ((x - 0.51) ** 2 + (y - 0.48) ** 2 + (z - 0.5) ** 2 - radius**2) * np.exp(3 * x))
    small, large = (float(solid_fractions(ball, (n, n, n), n, shift=shift).mean()) for shift in (step, -step))
    # the slope is that at the voxel, not at the wall: an error of second order, the same to both sides
    expected = [4 / 3 * np.pi * (radius + shift / n) ** 3 for shift in (-step, step)]
    assert [small, large] == pytest.approx(expected, rel=0.02)
    assert large - small == pytest.approx(expected[1] - expected[0], rel=0.02)
