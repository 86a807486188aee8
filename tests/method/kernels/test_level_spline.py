"""The level spline: constants, means, slopes across planes, layers against the whole, and the Newton steps on it."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.grading.local_porosity import block_counts, smoothed_means
from sppm_pipeline.features.grading.numerics.curve import porosity_curve
from sppm_pipeline.features.grading.numerics.local_level import CellCodes, fit_level, void_and_slope
from sppm_pipeline.method.kernels.level_spline import LayerSpline, control_of_means, control_with_some_held, extended

CONTROL = np.random.default_rng(3).normal(size=(3, 4, 1))


def middles(n, count):
    return (np.arange(n * count) + 0.5) / n


def test_a_constant_stays_one_and_goes_on_beyond_the_lattice(spline_values):
    x = np.linspace(-1, 4, 23)
    assert np.allclose(spline_values(np.full((3, 3, 3), 0.7), x, x, x), 0.7)
    values = spline_values(CONTROL, np.array([-0.5, 0, 3, 3.5]), np.array([1.2]), np.array([0.3]))[0, 0]
    assert values[0] == values[1]
    assert values[2] == values[3]


def test_values_and_slopes_are_continuous_across_the_planes_of_the_lattice(spline_values):
    h = 1e-4
    y, z = np.linspace(0.1, 3.9, 7), np.array([0.4])
    for plane in (0.0, 1.0, 2.0, 3.0):
        at = spline_values(CONTROL, plane + h * np.array([-2, -1, -1e-9, 1e-9, 1, 2]), y, z)[0]
        assert np.abs(at[:, 3] - at[:, 2]).max() < 1e-10
        left, right = (at[:, 1] - at[:, 0]) / h, (at[:, 5] - at[:, 4]) / h
        assert np.abs(left - right).max() < 20 * h


def test_means_of_cells_come_out_as_asked(spline_values):
    n = 40
    means = np.random.default_rng(5).normal(size=(3, 1, 5))
    control = control_of_means(means)
    values = spline_values(control, middles(n, 3), middles(n, 1), middles(n, 5))
    found = values.reshape(5, n, 1, n, 3, n).mean((1, 3, 5)).T
    assert np.abs(found - means).max() < 5e-4  # of the midpoint rule
    assert np.abs(control - means).max() > 0.1


def test_means_of_the_others_come_out_where_some_control_points_are_held(spline_values):
    rng = np.random.default_rng(6)
    means, held = rng.normal(size=(4, 3, 2)), rng.random((4, 3, 2)) < 0.3
    assert 3 < held.sum() < 12
    control = control_with_some_held(means, held)
    assert (control[held] == 0).all()
    n = 40
    values = spline_values(control, middles(n, 4), middles(n, 3), middles(n, 2))
    found = values.reshape(2, n, 3, n, 4, n).mean((1, 3, 5)).T
    assert np.abs(found - means)[~held].max() < 1e-3
    assert np.allclose(control_with_some_held(means, np.zeros_like(held)), control_of_means(means), atol=1e-8)


def test_layers_are_those_of_the_whole_and_depend_on_their_position_alone(spline_values):
    x, y, z = middles(7, 3), middles(5, 4), np.linspace(-0.2, 1.2, 9)
    whole = spline_values(CONTROL, x, y, z)
    layers, some = LayerSpline(CONTROL, x, y, z), LayerSpline(CONTROL, x[4:9], y[3:], z[4:])
    rows, columns = slice(0, len(y)), slice(0, len(x))
    for k in (0, 4, 8):
        found = layers.less(0.5, k, rows, columns)
        assert np.allclose(0.5 - found, whole[k], atol=1e-6)
        assert np.array_equal(layers.less(0.5, k, slice(3, 17), slice(4, 9)), found[3:17, 4:9])
    assert np.array_equal(some.less(0.5, 4, slice(0, 17), slice(0, 5)), found[3:, 4:9])


def test_samples_of_a_cell_count_by_how_far_they_are_from_the_level(spline_values):
    rng = np.random.default_rng(7)
    control = rng.normal(-1.4, 0.4, (3, 3, 3))
    values = rng.normal(-1.4, 0.6, (6, 6, 6))
    codes = CellCodes(lambda run: [(values, None)], -1.4, 4.0, 1e9)
    t = 1 + (np.arange(6) + 0.5) / 6
    more = values - spline_values(control, t, t, t)
    share, slope = void_and_slope(codes, control, [(1, 1, 1)], 0.4)[0]
    ramp, half = (np.clip(more / width + 0.5, 0, 1).mean() for width in (0.4, 0.2))
    assert share == pytest.approx((4 * half - ramp) / 3, abs=5e-4)
    assert slope == pytest.approx((np.abs(more) < 0.2).mean() / 0.4, abs=1e-9)


def test_ramps_tell_the_void_of_a_ball_better_than_whole_samples_do():
    """A pore that lies anywhere in the cell, its Gaussian cut where it has a radius of .31."""
    rng, width, errors = np.random.default_rng(3), 0.8, []
    grid = (np.arange(24) + 0.5) / 24
    for _ in range(40):
        z, y, x = (grid - c for c in rng.uniform(0.4, 0.6, 3))
        values = -14.4 * (z[:, None, None] ** 2 + y[:, None] ** 2 + x**2)
        codes = CellCodes(lambda run, values=values: [(values, None)], -1.4, 4.0, 1e9)
        control, true = np.full((1, 1, 1), -14.4 * 0.31**2), 4 / 3 * np.pi * 0.31**3
        counted = (values >= control[0, 0, 0]).mean()
        errors.append((void_and_slope(codes, control, [(0, 0, 0)], width)[0][0] - true, counted - true))
    ramps, whole = np.sqrt((np.array(errors) ** 2).mean(0))
    assert ramps < 1e-4
    assert ramps < 0.2 * whole


def test_what_is_not_known_follows_its_neighbors():
    x, y, z = np.indices((6, 5, 4)).astype(float)
    known = np.ones(x.shape, bool)
    known[2:4, 1:4, 1:3] = False
    linear = 1 + x - 2 * y + 3 * z
    assert np.abs(extended(np.where(known, linear, 99.0), known) - linear).max() < 1e-3
    assert not extended(linear, np.zeros_like(known)).any()


def porous(rng, cells, n):
    """Values of cells that are random but smooth, and their distribution differs from cell to cell."""
    shift = dict(zip(cells, rng.normal(0, 0.2, len(cells)), strict=True))
    waves = rng.normal(size=(6, 4))

    def values(cell):
        grid = np.stack(np.meshgrid(*((np.arange(n) + 0.5) / n + c for c in cell[::-1]), indexing="ij"))
        return shift[cell] - 1.4 + sum(np.sin(6 * np.einsum("i,izyx->zyx", w[:3], grid) + w[3]) for w in waves) / 3

    return values


@pytest.mark.parametrize("memory", [1e9, 0.0], ids=["kept", "asked for again"])
def test_every_cell_gets_its_porosity_also_where_only_a_part_of_it_counts(memory, spline_values):
    cells = [(i, j, 0) for i in range(4) for j in range(3) if (i, j) != (1, 1)]
    values = porous(np.random.default_rng(1), cells, 20)
    half = np.zeros((20, 20, 20), bool)
    half[:, :, :9] = True
    asked = []

    def sample(run):
        asked.extend(run)
        return [(values(cell), half if cell == (3, 2, 0) else None) for cell in run]

    targets = np.linspace(0.35, 0.6, len(cells))
    codes = CellCodes(sample, -1.4, 4.0, memory)
    fit = fit_level(codes, cells, targets, np.full((4, 3, 1), -1.4), (-3.0, -0.2), 0.1, 5e-4, 20)
    assert np.abs(fit.errors).max() <= 5e-4
    assert fit.steps < 12
    assert not fit.at_bound.any()
    assert len(asked) == len(cells) * (1 if memory else fit.steps)
    # counted without codes
    for cell, target in zip(cells, targets, strict=True):
        x, y, z = (np.arange(20) / 20 + 0.025 + c for c in cell)
        void = values(cell) >= spline_values(fit.values, x, y, z)
        assert (void[half] if cell == (3, 2, 0) else void).mean() == pytest.approx(target, abs=1.5e-3)


def test_a_cell_that_would_leave_the_bounds_keeps_them_and_is_told():
    cells = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    values = porous(np.random.default_rng(2), cells, 16)
    codes = CellCodes(lambda run: [(values(cell), None) for cell in run], -1.4, 4.0, 1e9)
    fit = fit_level(codes, cells, np.array([0.5, 0.5, 0.02]), np.full((3, 1, 1), -1.4), (-2.5, -1.0), 0.1, 1e-3, 15)
    assert fit.at_bound.tolist() == [False, False, True]
    assert fit.values[2, 0, 0] == -1.0
    assert fit.errors[2] > 0.1
    assert np.abs(fit.errors[:2]).max() <= 1e-3


def test_cells_around_one_at_its_bound_converge_also_beside_cells_outside():
    """What the cell lacks is no reason to change the level outside of the part, which would move its neighbors."""
    cells = [(i, j, 0) for i in range(3) for j in range(3)]
    values = porous(np.random.default_rng(2), cells, 16)
    part = np.zeros((16, 16, 16), bool)
    part[:, :, :8] = True
    codes = CellCodes(lambda run: [(values(c), part if c[0] == 2 else None) for c in run], -1.4, 4.0, 1e9)
    targets = np.array([(values(c) >= -1.5)[part if c[0] == 2 else ...].mean() for c in cells])
    targets[7] -= 0.2
    fit = fit_level(codes, cells, targets, np.full((5, 3, 1), -1.4), (-3.0, -1.2), 0.1, 1e-3, 15)
    assert fit.at_bound.tolist() == [m == 7 for m in range(9)]
    assert np.abs(np.delete(fit.errors, 7)).max() <= 1e-3
    assert fit.steps < 15


def test_a_curve_is_inverted_and_says_where_it_cannot():
    curve = porosity_curve([20, 20, 40, 40, 80, 80], [0.2, 0.22, 0.4, 0.42, 0.69, 0.71])
    assert curve.pores(np.array([0.21, 0.41, 0.7])) == pytest.approx([20, 40, 80])
    assert curve.deviation == pytest.approx(0.01 * np.sqrt(2))
    slopes = curve.slope(np.array([20.0, 60, 500]))
    assert (slopes > 0).all()
    assert slopes[0] > slopes[1]
    with pytest.raises(DesignError, match="does not grow"):
        porosity_curve([10, 20], [0.5, 0.4])


def test_means_in_a_window_weigh_what_is_inside():
    rng = np.random.default_rng(0)
    void, inside = rng.random((8, 16, 8)) < 0.3, rng.random((8, 16, 8)) < 0.6
    open_, all_ = block_counts(void, inside, 4)
    assert open_.shape == (2, 4, 2)
    assert open_[1, 2, 0] == (void & inside)[4:, 8:12, :4].sum()
    assert all_.sum() == inside.sum()
    weights = (all_ > all_.min()).astype(float)
    means = smoothed_means(np.where(weights > 0, 0.25, 9.0), weights)
    assert np.allclose(means[weights > 0], 0.25)
    assert np.isnan(means[weights == 0]).all()
    ramp = np.arange(33.0).reshape(33, 1, 1)
    assert smoothed_means(ramp, np.ones_like(ramp))[16, 0, 0] == pytest.approx(16)
    peak = smoothed_means((ramp == 16).astype(float), np.ones_like(ramp))[:, 0, 0]
    assert np.sqrt((peak * (ramp[:, 0, 0] - 16) ** 2).sum() / peak.sum()) == pytest.approx(4, rel=0.02)
