"""Stretched kernels: a stretched structure is the plain one of unstretched places, along any axis."""

import numpy as np
import pytest

from sppm_pipeline.method.kernels.kernels import Kernels, concatenated, kernel_reaches, reach_boxes, steepest
from sppm_pipeline.method.kernels.splat import add_kernels
from sppm_pipeline.services.grid import Grid
from sppm_pipeline.services.metric import PLAIN, determinants, lengths_in, stretched_metric, upper_roots
from sppm_pipeline.testing.exact_sum import cutoff_bound, exact_sum

CUTOFF = 1e-9
GRID = Grid((0.01, 0.02, -0.1), (1 / 47, 1 / 33, 1 / 29), (47, 31, 33))
CLOSE = 6e-6
"""Some rounding of float32 in sums of up to 5; with the cut-off above nothing else differs."""


def plain_kernels(seed=1, n=12):
    rng = np.random.default_rng(seed)
    centers, edges = rng.random((n, 3)), rng.integers(0, n, (20, 2))
    ends = centers[edges[:, 1]]
    ends[0] = centers[edges[0, 0]] + (0.3, 0, 0)  # along the rows
    ends[1] = centers[edges[1, 0]]  # no length
    return Kernels(centers, rng.uniform(60, 120, n), centers[edges[:, 0]], ends, rng.uniform(30, 60, len(edges)))


def stretched(kernels, stretch, direction):
    metrics = [
        stretched_metric(np.full(n, float(stretch)), np.tile(np.asarray(direction, float), (n, 1)))
        for n in (len(kernels.omega), len(kernels.mu))
    ]
    return kernels._replace(pore_metric=metrics[0], tunnel_metric=metrics[1])


def varied(kernels):
    rng = np.random.default_rng(5)
    n, m = len(kernels.omega), len(kernels.mu)
    metric = stretched_metric(rng.uniform(0.6, 2.0, n + m), rng.standard_normal((n + m, 3)))
    return kernels._replace(pore_metric=metric[:n], tunnel_metric=metric[n:])


def summed(kernels, grid=GRID, **options):
    out = np.zeros(grid.shape[::-1], np.float32)
    add_kernels(out, grid, kernels, CUTOFF, **options)
    return out


def places(grid):
    z, y, x = np.meshgrid(*(grid.axis(axis) for axis in (2, 1, 0)), indexing="ij")
    return np.stack([x, y, z], -1).reshape(-1, 3)


def test_the_fast_sum_is_the_exact_one():
    kernels = varied(plain_kernels())
    assert np.abs(summed(kernels).ravel() - exact_sum(kernels, places(GRID))).max() < CLOSE


@pytest.mark.parametrize(("stretch", "direction"), [(1.7, (0, 0, 2)), (0.6, (1, 0, 0)), (2.2, (1, -2, 0.5))])
def test_a_stretched_structure_is_the_plain_one_at_unstretched_places(stretch, direction):
    plain, unit = plain_kernels(), np.array(direction) / np.linalg.norm(direction)
    stretching = np.eye(3) + (stretch - 1) * np.outer(unit, unit)
    moved = plain._replace(
        centers=plain.centers @ stretching, starts=plain.starts @ stretching, ends=plain.ends @ stretching
    )
    found = summed(stretched(moved, stretch, direction))
    wanted = exact_sum(plain, places(GRID) @ np.linalg.inv(stretching))
    assert np.abs(found.ravel() - wanted).max() < CLOSE


def test_along_an_axis_of_the_grid_stretching_the_grid_is_the_same():
    plain, s = plain_kernels(), 1.6
    along = np.array([1, 1, s])
    moved = plain._replace(centers=plain.centers * along, starts=plain.starts * along, ends=plain.ends * along)
    origin, spacing = (tuple(np.array(v) * along) for v in (GRID.origin, GRID.spacing))
    grid = Grid(origin, spacing, GRID.shape)
    assert np.abs(summed(stretched(moved, s, (0, 0, 1)), grid) - summed(plain)).max() < CLOSE


def test_a_factor_of_one_and_no_direction_change_nothing():
    plain = plain_kernels()
    for kernels in (stretched(plain, 1, (1, 2, 3)), stretched(plain, 3, (0, 0, 0))):
        assert np.allclose(kernels.pore_metric, PLAIN, atol=1e-15)
        assert np.abs(summed(kernels) - summed(plain)).max() < CLOSE


def test_slabs_threads_and_wanted_rows_change_no_value():
    kernels = varied(plain_kernels())
    whole = summed(kernels)
    assert np.array_equal(summed(kernels, threads=3), whole)
    slab = np.zeros((7, *whole.shape[1:]), np.float32)
    add_kernels(slab, GRID, kernels, CUTOFF, first_layer=11)
    assert np.array_equal(slab, whole[11:18])
    wanted = np.tile(np.array([13, 29], np.int32), (*whole.shape[:2], 1))
    assert np.abs(summed(kernels, wanted=wanted)[..., 13:29] - whole[..., 13:29]).max() < CLOSE


def test_boxes_hold_the_reach_and_touch_it():
    kernels = varied(plain_kernels())
    lower, upper, *_ = reach_boxes(kernels, 1e-4)
    farthest, _ = kernel_reaches(kernels, 1e-4)
    rng = np.random.default_rng(2)
    unit = rng.standard_normal((4000, 3))
    for i in range(4):
        metric = np.tile(kernels.pore_metric[i], (len(unit), 1))
        reach = np.sqrt(np.log(1e4) / kernels.omega[i])
        border = kernels.centers[i] + reach * unit / lengths_in(metric, unit)[:, None]
        assert (border >= lower[i] - 1e-12).all()
        assert (border <= upper[i] + 1e-12).all()
        assert np.abs(border.max(0) - upper[i]).max() < 0.03 * reach
        length = np.linalg.norm(border - kernels.centers[i], axis=1).max()
        assert 0.97 * farthest[i] < length <= farthest[i] * (1 + 1e-9)


def test_metrics_have_the_volume_and_the_sizes_of_their_stretch():
    metric = stretched_metric(np.array([2.0, 0.5]), np.array([[1.0, 1, 0], [0, 0, 3]]))
    assert np.allclose(determinants(metric), [1 / 4, 4])
    assert np.allclose(lengths_in(metric, np.array([[2.0, 2, 0], [0, 0, 1]])), [np.sqrt(2), 2])
    root = upper_roots(metric)
    assert np.allclose(np.tril(root, -1), 0)
    assert np.allclose(root[0].T @ root[0] @ (1, 1, 0), np.array([1, 1, 0]) / 4)
    kernels = stretched(plain_kernels(), 0.5, (0, 0, 1))
    # half as long: the parameters are those of half the radius
    omega, mu = steepest(kernels)
    assert (omega, mu) == pytest.approx((4 * kernels.omega.max(), 2 * kernels.mu.max()))


def test_sets_with_and_without_metrics_go_together():
    plain = plain_kernels()
    both = concatenated([plain, stretched(plain_kernels(2), 2, (1, 0, 0))])
    assert np.array_equal(both.pore_metric[0], PLAIN)
    alone = summed(plain) + summed(stretched(plain_kernels(2), 2, (1, 0, 0)))
    assert np.abs(summed(both) - alone).max() < CLOSE
    assert concatenated([plain, plain]).pore_metric is None


def test_what_can_not_be_summed_is_refused():
    kernels = stretched(plain_kernels(), 2, (1, 0, 0))
    with pytest.raises(ValueError, match="both have metrics"):
        summed(kernels._replace(tunnel_metric=None))
    with pytest.raises(ValueError, match="not positive definite"):
        summed(kernels._replace(pore_metric=-kernels.pore_metric))
    with pytest.raises(ValueError, match="stretched"):
        cutoff_bound(kernels, (0, 0, 0), (1, 1, 1))
