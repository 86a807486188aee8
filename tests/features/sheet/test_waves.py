"""Sums of waves against the written sum, and what relaxing does."""

import numpy as np
import pytest

from sppm_pipeline.features.sheet.numerics.waves import (
    Waves,
    band_of,
    moments_of,
    relaxed,
    sum_of_waves,
    with_isotropic_power,
)

AXIS = np.linspace(-0.3, 1.4, 7)


def some_field(seed=0, steps=5, **options):
    rng = np.random.default_rng(seed)
    points, charges = rng.random((60, 3)), rng.choice([-1.0, 1.0], 60)
    return relaxed(points, charges, 2.6, 0.2, steps, **options)


def test_the_sum_is_that_of_every_wave_by_itself():
    waves, x, y, z = some_field().waves, AXIS, AXIS[1:] / 3, AXIS[2:] ** 2
    most = len(waves.real) - 1
    by_hand = np.zeros((7, 6, 5))
    for kx, ky, kz in np.argwhere(waves.real + waves.imaginary != 0):
        turn = 2 * np.pi * (kx * x[:, None, None] + (ky - most) * y[:, None] + (kz - most) * z)
        by_hand += waves.real[kx, ky, kz] * np.cos(turn) - waves.imaginary[kx, ky, kz] * np.sin(turn)
    assert sum_of_waves(waves, x, y, z) == pytest.approx(by_hand, abs=1e-12)


def test_a_gyroid_is_a_sum_of_six_waves():
    real, imaginary = np.zeros((2, 3, 3)), np.zeros((2, 3, 3))
    # sin x cos y = (sin(x + y) + sin(x - y)) / 2, and the sine is minus the imaginary part
    for kx, ky, kz, sign in ((1, 1, 0, 1), (1, -1, 0, 1), (0, 1, 1, 1), (0, 1, -1, 1), (1, 0, 1, 1), (1, 0, -1, -1)):
        imaginary[kx, ky + 1, kz + 1] = -0.5 * sign
    x, y, z = (2 * np.pi * axis for axis in (AXIS[:, None, None], AXIS[:, None], AXIS))
    gyroid = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    assert sum_of_waves(Waves(real, imaginary), AXIS, AXIS, AXIS) == pytest.approx(gyroid, abs=1e-12)


def test_samples_are_the_sum_and_its_slope_and_have_variance_one():
    made = some_field()
    n = len(made.samples)
    axis = np.arange(n) / n
    assert sum_of_waves(made.waves, axis, axis, axis) == pytest.approx(made.samples, abs=1e-12)
    assert made.samples.mean() == pytest.approx(0, abs=1e-12)
    assert made.samples.std() == pytest.approx(1, abs=1e-6)
    step = 1e-5
    ahead = [axis + step * (i == 0) for i in range(3)], [axis + step * (i == 1) for i in range(3)]
    ahead += ([axis + step * (i == 2) for i in range(3)],)
    slopes = [(sum_of_waves(made.waves, *place) - made.samples) / step for place in ahead]
    assert np.sqrt(sum(part**2 for part in slopes)) == pytest.approx(made.slopes, abs=1e-2)


def power_moments(waves, metric=None):
    kept = np.argwhere(waves.real**2 + waves.imaginary**2 > 0)
    power = (waves.real**2 + waves.imaginary**2)[tuple(kept.T)]
    vectors = (kept - [0, len(waves.real) - 1, len(waves.real) - 1]) @ (np.eye(3) if metric is None else metric)
    return moments_of(vectors) @ power / power.sum()


def test_directions_are_alike_to_fourth_order():
    assert np.abs(power_moments(some_field(1).waves)).max() < 0.02
    # none but the moments is asked for: chance prefers some directions without the correction
    vectors, weights = band_of(2.6, 0.2, np.eye(3))
    rng = np.random.default_rng(1)
    plain = weights * (rng.normal(size=len(vectors)) + 1j * rng.normal(size=len(vectors)))
    moments = moments_of(vectors.astype(float))
    before = np.abs(moments @ np.abs(plain) ** 2).max()
    after = np.abs(moments @ np.abs(with_isotropic_power(plain, moments)) ** 2).max()
    assert after < 0.2 * before


def test_moments_of_all_directions_vanish():
    rng = np.random.default_rng(0)
    means = moments_of(rng.normal(size=(200_000, 3))).mean(1)
    assert np.abs(means).max() < 0.004
    assert len(means) == 15


def test_one_of_each_pair_of_waves_is_in_the_band():
    vectors, weights = band_of(3.0, 0.2, np.eye(3))
    both = np.concatenate([vectors, -vectors])
    assert len(np.unique(both, axis=0)) == len(both)
    lengths = np.linalg.norm(vectors, axis=1)
    assert weights == pytest.approx(np.exp(-(((lengths / 3 - 1) / 0.2) ** 2)))
    every = np.stack(np.meshgrid(*[np.arange(-6, 7)] * 3), -1).reshape(-1, 3)
    near = np.exp(-(((np.linalg.norm(every, axis=1) / 3 - 1) / 0.2) ** 2)) >= 1e-3
    assert near.sum() == len(both)


def squared_curvature(made):
    """Mean square of the mean curvature over the zero of a field, from differences."""
    n = 64
    axis = np.arange(n) / n
    f = sum_of_waves(made.waves, axis, axis, axis)

    def slope(values, along):
        return (np.roll(values, -1, along) - np.roll(values, 1, along)) * n / 2

    gradient = [slope(f, along) for along in range(3)]
    length = np.sqrt(sum(part**2 for part in gradient))
    mean = sum(slope(part / length, along) for along, part in enumerate(gradient)) / 2
    near = np.abs(f) < 0.15
    # an even layer about the surface has the weight of its area where it is thin
    return float((mean[near] ** 2 * length[near]).sum() / length[near].sum())


def test_relaxing_makes_a_surface_nearly_minimal():
    before, after = squared_curvature(some_field(2, steps=0)), squared_curvature(some_field(2, steps=40))
    assert after < 0.4 * before


def test_a_metric_stretches_the_waves():
    metric = np.diag([1.0, 1.0, 2.0])
    vectors, _ = band_of(2.6, 0.2, metric)
    assert np.abs(vectors[:, 2]).max() <= 2 < np.abs(vectors[:, 0]).max()
    made = some_field(3, metric=metric)
    assert np.abs(power_moments(made.waves, metric)).max() < 0.05
    gradient = [np.diff(made.samples, axis=axis).std() for axis in range(3)]
    assert gradient[0] / gradient[2] == pytest.approx(2, rel=0.15)
