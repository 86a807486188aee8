"""Interpolation from coarse planes: exact for polynomials, of high order, the same however it is cut."""

import numpy as np
import pytest

from sppm_pipeline.services.interpolation import BLOCK, TAPS, band_of, interpolate_layers, stretch, taps_at


def interpolated(coarse, x, y, z, *, level=0.0, spans=None, bands=1000, solid=False):
    """The function sampled at 0, 1, 2, ... in `coarse` (nz, ny, nx), at fine positions along each axis."""
    taps = [taps_at(np.asarray(places, float)) for places in (x, y, z)]
    window = [slice(int(t.first[0]), int(t.first[-1]) + TAPS) for t in taps]
    planes = np.ascontiguousarray(coarse[:, window[1], window[0]])
    band = band_of(taps[0])
    wide = np.zeros((*planes.shape[:2], len(band.first) * BLOCK), np.float32)
    for plane, stretched in zip(planes, wide, strict=True):
        stretch(plane, band, np.tile(np.array([0, len(band.first)], np.int32), (len(plane), 1)), stretched)
    ny, nx = len(y), len(x)
    spans = np.tile(np.array([0, nx], np.int32), (len(z), ny, 1)) if spans is None else np.tile(spans, (len(z), 1, 1))
    out = np.zeros((len(z), ny, nx), np.uint8 if solid else np.float32)
    for row in range(0, ny, bands):
        rows = range(row, min(row + bands, ny))
        places = {"solid": out, "field": None} if solid else {"field": out, "solid": None}
        interpolate_layers(wide, *taps[2], taps[1], level, rows, spans, **places)
    return out


def of(function, x, y, z):
    return function(np.asarray(x)[None, None], np.asarray(y)[None, :, None], np.asarray(z)[:, None, None])


WHOLE = np.arange(24.0)
X, Y, Z = np.arange(3.0, 19.0, 0.37), np.arange(2.2, 17.0, 0.61), np.arange(4.0, 20.0, 0.83)


def bumps(x, y, z):
    return np.exp(-0.02 * ((x - 9) ** 2 + (y - 8) ** 2 + (z - 12) ** 2)) + 0.3 * np.sin(0.3 * x + 0.2 * y - 0.25 * z)


def test_weights_add_up_to_one_and_a_coarse_sample_is_met():
    taps = taps_at(np.linspace(-7.3, 9.1, 500))
    assert np.abs(taps.weights.sum(1) - 1).max() < 1e-6
    assert np.abs(taps.weights).sum(1).max() < 1.4
    exact = taps_at(np.array([-3.0, 0.0, 5.0]))
    assert np.array_equal(exact.first, [-5, -2, 3])
    assert np.array_equal(exact.weights, np.tile([0, 0, 1, 0, 0, 0], (3, 1)))


def test_positions_that_differ_by_rounding_have_the_same_taps():
    counted = 0.1 * np.arange(1000)
    summed = 7.3 + 0.1 * (np.arange(1000) - 73)
    assert (counted != summed).any()
    for a, b in zip(taps_at(counted), taps_at(summed), strict=True):
        assert np.array_equal(a, b)


@pytest.mark.parametrize("powers", [(0, 0, 0), (5, 0, 0), (0, 5, 0), (0, 0, 5), (3, 2, 4), (5, 5, 5)])
def test_polynomials_of_degree_five_are_exact(powers):
    def polynomial(x, y, z):
        return (x / 12 - 1) ** powers[0] * (y / 12 - 1) ** powers[1] * (z / 12 - 1) ** powers[2]

    values = interpolated(of(polynomial, WHOLE, WHOLE, WHOLE).astype(np.float32), X, Y, Z)
    assert np.abs(values - of(polynomial, X, Y, Z)).max() < 1e-6


def test_the_error_falls_with_the_sixth_power_of_the_spacing():
    errors = []
    for h in (2.0, 1.0):
        coarse = of(bumps, h * WHOLE, h * WHOLE, h * WHOLE).astype(np.float32)
        x = np.arange(8.0, 16.0, 0.21)
        errors.append(np.abs(interpolated(coarse, x / h, x / h, x / h) - of(bumps, x, x, x)).max())
    assert errors[1] < errors[0] / 30
    assert errors[1] < 3e-5


@pytest.mark.parametrize(("pitch", "count"), [(0.05, 90), (0.37, 50), (0.99, 33), (2.6, 40), (1.0, 1)])
def test_rows_are_stretched_at_any_pitch(pitch, count):
    taps = taps_at(3.3 + pitch * np.arange(count))
    band, first = band_of(taps), taps.first - taps.first[0]
    coarse = np.random.default_rng(2).random((3, first[-1] + TAPS), dtype=np.float32)
    out = np.full((3, len(band.first) * BLOCK), np.nan, np.float32)
    stretch(coarse, band, np.array([[0, 0], [0, len(band.first)], [0, len(band.first)]], np.int32), out)
    expected = (coarse[..., first[:, None] + np.arange(TAPS)].astype(float) * taps.weights).sum(-1)
    assert np.abs(out[1:, :count] - expected[1:]).max() < 1e-6
    assert np.isnan(out[0]).all()
    some, at = np.full_like(out, np.nan), (len(band.first) - 1) // 2
    block = slice(at * BLOCK, at * BLOCK + BLOCK)
    stretch(coarse, band, np.array([[0, 0], [at, at + 1], [1, 0]], np.int32), some)
    assert some[1, block].tobytes() == out[1, block].tobytes()
    some[1, block] = np.nan
    assert np.isnan(some).all()


def test_it_is_continuous_where_the_taps_change():
    coarse = np.random.default_rng(0).random((24, 24, 24), dtype=np.float32)
    eps = 1e-5
    for axis in range(3):
        sides = []
        for place in (9 - eps, 9 + eps):
            places = [X, Y, Z]
            places[axis] = [place]
            sides.append(interpolated(coarse, *places))
        assert np.abs(sides[0] - sides[1]).max() < 1e-4


def test_solid_is_the_sign_and_rows_bands_and_wanted_parts_change_no_bit():
    coarse = of(bumps, WHOLE, WHOLE, WHOLE).astype(np.float32)
    whole = interpolated(coarse, X, Y, Z, level=0.2)
    assert 0.2 < (whole < 0).mean() < 0.8
    assert np.array_equal(interpolated(coarse, X, Y, Z, level=0.2, solid=True), whole < 0)
    assert interpolated(coarse, X, Y, Z, level=0.2, bands=3).tobytes() == whole.tobytes()
    spans = np.sort(np.random.default_rng(1).integers(0, len(X) + 1, (len(Y), 2)), 1).astype(np.int32)
    spans[4] = 7
    wanted = (np.arange(len(X)) >= spans[:, :1]) & (np.arange(len(X)) < spans[:, 1:])
    for solid, expected in ((False, whole), (True, whole < 0)):
        part = interpolated(coarse, X, Y, Z, level=0.2, spans=spans, solid=solid)
        assert np.array_equal(part, np.where(wanted, expected, 0))
    # of the positions themselves, not of where rows begin
    assert interpolated(coarse, X[5:], Y[3:20], Z[2:], level=0.2).tobytes() == whole[2:, 3:20, 5:].tobytes()
