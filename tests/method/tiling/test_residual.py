"""Residual periodicity: exact cases, and the Bragg peaks it stands for."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sppm_pipeline.method.tiling.residual import axis_correlation, bragg_share, folded_shares, mean_cell


def spectral_share(image, cells):
    power = abs(np.fft.fftn(image - image.mean())) ** 2
    return power[:: cells[0], :: cells[1], :: cells[2]].sum() / power.sum()


def assembled(choice, patterns):
    """Image whose cell (i, j, k) is ``patterns[choice[i, j, k]]``."""
    return np.block([[[patterns[c] for c in row] for row in plane] for plane in choice.tolist()])


def test_a_periodic_image_repeats_entirely():
    cell = np.random.default_rng(0).random((5, 4, 6)) < 0.3
    image = np.tile(cell, (3, 2, 4))
    assert bragg_share(image, (3, 2, 4)) == pytest.approx(1.0)
    assert bragg_share(image, (3, 2, 4), corrected=False) == pytest.approx(1.0)
    assert axis_correlation(image, (3, 2, 4)) == pytest.approx((1.0, 1.0, 1.0, 1.0))
    assert np.allclose(mean_cell(image, (3, 2, 4)), cell)


def test_independent_noise_does_not_repeat():
    cells = (4, 4, 4)
    image = np.random.default_rng(1).normal(size=(48, 48, 48))
    assert bragg_share(image, cells, corrected=False) == pytest.approx(1 / 64, rel=0.1)
    assert abs(bragg_share(image, cells)) < 0.0015
    assert abs(axis_correlation(image, cells).mean) < 0.01


def test_correction_is_unbiased_for_cells_that_are_random_as_a_whole():
    # Voxels of a cell agree in blocks, so that there are few independent numbers in a cell and the raw bias is large.
    rng = np.random.default_rng(2)
    raw, corrected = [], []
    for _ in range(300):
        image = np.kron(rng.normal(size=(4, 4, 4)), np.ones((2, 2, 2)))
        raw.append(bragg_share(image, (2, 2, 2), corrected=False))
        corrected.append(bragg_share(image, (2, 2, 2)))
    assert np.mean(raw) > 0.1
    assert abs(np.mean(corrected)) < 4 * np.std(corrected) / math.sqrt(300)


def test_half_and_half_of_two_patterns_in_quadrature():
    # Two patterns of mean 0, variance 1 and no correlation; half of the M cells show each.
    wave = 2 * np.pi * np.arange(8) / 8
    patterns = [np.sqrt(2) * f(wave)[:, None, None] * np.ones((8, 3, 3)) for f in (np.cos, np.sin)]
    choice = np.indices((4, 2, 2)).sum(axis=0) % 2
    image = assembled(choice, patterns)
    count = choice.size
    assert bragg_share(image, choice.shape, corrected=False) == pytest.approx(0.5)
    assert bragg_share(image, choice.shape) == pytest.approx((count / 2 - 1) / (count - 1))
    # In a chequerboard neighbors always differ; in stripes along x only neighbors along x do.
    assert axis_correlation(image, choice.shape) == pytest.approx((0.0, 0.0, 0.0, 0.0), abs=1e-12)
    stripes = assembled(np.indices((4, 2, 2))[0] % 2, patterns)
    assert axis_correlation(stripes, (4, 2, 2)) == pytest.approx((0.0, 1.0, 1.0, 2 / 3))


def test_signal_plus_noise_has_the_signals_share():
    rng = np.random.default_rng(3)
    signal = np.tile(rng.normal(size=(10, 10, 10)), (5, 5, 5))
    image = signal + math.sqrt(3.0) * rng.normal(size=signal.shape)
    assert bragg_share(image, (5, 5, 5)) == pytest.approx(0.25, abs=0.02)
    assert axis_correlation(image, (5, 5, 5)).mean == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("cells", [(3, 2, 4), (1, 2, 1), (6, 8, 8)])
def test_parseval(cells):
    image = np.random.default_rng(4).random((12, 8, 16)) < 0.4
    assert bragg_share(image, cells, corrected=False) == pytest.approx(spectral_share(image.astype(float), cells))


def scaffold(n):
    """Solid in the part of a cell that lies within 1/8 of its edges."""
    near = np.minimum(np.arange(n) + 0.5, n - 0.5 - np.arange(n)) / n < 1 / 8
    x, y, z = near[:, None, None], near[:, None], near
    return (x & y) | (y & z) | (x & z)


@pytest.mark.parametrize("n", [16, 32])
def test_folding_a_scaffold_shows_its_bars(n):
    cell = scaffold(n)
    folded = folded_shares(np.tile(cell, (3, 2, 4)), (3, 2, 4))
    assert folded[:4] == pytest.approx((1.0, 1.0, 0.0, 0.0))
    assert folded.deviation == pytest.approx(cell.std())
    lifted = folded_shares(np.tile(np.roll(cell, n // 2, axis=(0, 1, 2)), (2, 2, 2)), (2, 2, 2))
    assert lifted.corner == 0.0
    assert lifted.center > 0.4


def test_windows_of_the_fold_are_weighed_by_overlap():
    """A field that is linear between the planes of the lattice has the same shares on every grid."""

    def rising(n):
        x = np.abs((np.arange(n) + 0.5) / n - 0.5)[:, None, None] * np.ones((1, n, n))
        return folded_shares(np.tile(x, (2, 1, 1)), (2, 1, 1))

    assert rising(48)[:4] == pytest.approx(rising(16)[:4])
    # along one of three axes 15/32 near the plane, 1/8 in the middle half
    assert rising(16)[:4] == pytest.approx((15 / 32, (2 * 15 / 32 + 1 / 8) / 3, (15 / 32 + 2 / 8) / 3, 1 / 8))


def test_independent_cells_deviate_as_expected():
    rng = np.random.default_rng(8)
    cells = (4, 4, 4)
    found = [folded_shares(rng.random((32, 32, 32)) < 0.3, cells) for _ in range(5)]
    assert np.mean([f.deviation for f in found]) == pytest.approx(np.mean([f.expected for f in found]), rel=0.05)
    assert found[0].expected == pytest.approx(math.sqrt(0.3 * 0.7 / 64), rel=0.02)


def test_one_cell_along_an_axis_has_no_neighbor_there():
    image = np.random.default_rng(5).random((8, 4, 4))
    found = axis_correlation(image, (2, 1, 1))
    assert math.isnan(found.y)
    assert math.isnan(found.z)
    assert found.mean == found.x


def test_images_without_contrast():
    assert math.isnan(bragg_share(np.ones((4, 4, 4)), (2, 2, 2)))
    assert math.isnan(axis_correlation(np.ones((4, 4, 4)), (2, 2, 2)).mean)


def test_boolean_and_float_images_agree():
    image = np.random.default_rng(6).random((8, 8, 8)) < 0.5
    assert bragg_share(image, (2, 2, 2)) == bragg_share(image.astype(float), (2, 2, 2))
