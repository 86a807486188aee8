"""Interpolation reproduces what it can, restriction is its transpose, coarse voxels are means."""

import numpy as np
import pytest

from sppm_pipeline.services.multigrid.hierarchy import coarser
from sppm_pipeline.services.multigrid.transfer import (
    NodalTransfer,
    coarsened,
    coarser_widths,
    interpolate_add,
    restrict,
)

SHAPES = [(8, 6, 4), (5, 7, 9), (1, 2, 3), (3, 1, 16), (4, 5, 1)]


def shapes_of(fine):
    coarse = coarser(fine)
    return coarse, np.array([*fine[::-1], *coarse[::-1], 1], np.int64)


def axis_matrix(n):
    """Interpolation along one axis, as documented."""
    m = -(-n // 2)
    matrix = np.zeros((n, m))
    for place in range(n):
        node = (place + n % 2) % n
        matrix[node, place // 2] += 0.5
        matrix[node, (place + 1) // 2 % m] += 0.5
    return matrix


@pytest.mark.parametrize("fine", SHAPES)
@pytest.mark.parametrize("components", [1, 3])
def test_interpolation_and_its_transpose(fine, components):
    coarse, shapes = shapes_of(fine)
    rng = np.random.default_rng(1)
    c, f = rng.standard_normal((components, *coarse)), rng.standard_normal((components, *fine))
    a, b, d = (axis_matrix(n) for n in fine)
    expected = f + np.einsum("ai,bj,ck,nijk->nabc", a, b, d, c)
    out, scratch = f.reshape(-1).copy(), np.empty(max(fine) + 3)
    interpolate_add(c.reshape(-1), out, shapes, scratch)
    assert out.reshape(f.shape) == pytest.approx(expected)
    back = np.empty(c.size)
    restrict(f.reshape(-1), back, shapes, scratch)
    assert back.reshape(c.shape) == pytest.approx(np.einsum("ai,bj,ck,nabc->nijk", a, b, d, f))


@pytest.mark.parametrize("fine", SHAPES)
def test_coarse_voxels_are_means_of_their_children(fine):
    values = np.random.default_rng(2).random(fine)
    coarse, _ = shapes_of(fine)
    children = [[[(2 * i + j + n % 2) % n for j in (0, 1) if 2 * i + j < n] for i in range(-(-n // 2))] for n in fine]
    expected = np.empty(coarse)
    for place in np.ndindex(coarse):
        expected[place] = values[np.ix_(*(axis[i] for axis, i in zip(children, place, strict=True)))].mean()
    assert coarsened(values) == pytest.approx(expected)


@pytest.mark.parametrize("n", [5, 33, 130, 255, 257, 1000])
def test_no_coarse_voxel_is_shorter_than_half_the_others(n):
    widths, scale = [np.ones(n)], 1
    while len(widths[0]) > 2:
        widths, scale = coarser_widths(widths), 2 * scale
        assert widths[0].min() >= 0.5
        assert widths[0].max() <= 1
        assert widths[0].sum() * scale == pytest.approx(n)


def test_the_coarsest_grid_is_small():
    shape, count = (300, 7, 1), 0
    while (after := coarser(shape)) is not None:
        shape, count = after, count + 1
    assert max(shape) <= 2
    assert count == 8


@pytest.mark.parametrize("shape", [(6, 7, 5), (5, 4, 7), (7, 5, 1)])
def test_long_edges_wait_until_the_others_have_caught_up(shape):
    """Semi-coarsening: an axis that stays passes values through, and the restriction is the transpose."""
    coarse = coarser(shape, (1.0, 1.0, 2.0))
    assert coarse == (shape[0], -(-shape[1] // 2), -(-shape[2] // 2))
    assert coarser(shape, (2.0, 2.0, 2.0)) == coarser(shape)
    transfer = NodalTransfer.between(shape, coarse)
    random = np.random.default_rng(1)
    fine, rough = random.standard_normal(np.prod(shape)), random.standard_normal(np.prod(coarse))
    line = np.zeros(max(shape) + 3)
    down, up = np.zeros(rough.size), np.zeros(fine.size)
    transfer.restrict(fine, down, line)
    transfer.interpolate_add(rough, up, line)
    assert up @ fine == pytest.approx(rough @ down)
    # what varies along the long axis alone is kept
    along = np.broadcast_to(random.standard_normal(shape[0])[:, None, None], coarse).ravel()
    up[:] = 0
    transfer.interpolate_add(np.ascontiguousarray(along), up, line)
    assert up.reshape(shape) == pytest.approx(np.broadcast_to(along.reshape(coarse)[:, :1, :1], shape))
    values = random.standard_normal(shape)
    kept = coarsened(values, coarse)
    assert kept.shape == coarse
    assert kept == pytest.approx(np.stack([coarsened(layer) for layer in values]))
