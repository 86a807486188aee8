"""Coarse grids of the pressure: channels stay apart, cycles are symmetric, positive definite, and work in throats."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components

from sppm_pipeline.features.flow.numerics.channel_grids import ChannelGrids, pieces_of_blocks
from sppm_pipeline.features.flow.numerics.seven_point import hierarchy_of
from tests.features.flow.test_seven_point import matrix_of


def random_weights(shape, seed, share=0.45):
    """Throats and pores at random: weights over four orders of magnitude, many of them none."""
    rng = np.random.default_rng(seed)
    return tuple((10 ** rng.uniform(-4, 0, shape) * (rng.random(shape) < share)).astype(np.float32) for _ in range(3))


def cycled(grids, r):
    work = hierarchy_of(np.ones(grids.level.shape, np.float32), (np.ones(grids.level.shape, np.float32),) * 3)
    return grids.cycle(r.astype(np.float32), work.workspace(), grids.workspace()).copy()


@pytest.mark.parametrize("shape", [(6, 4, 8), (5, 7, 3), (1, 9, 2)])
def test_pieces_are_what_hangs_together_in_blocks(shape):
    weights = random_weights(shape, 3)
    grids = ChannelGrids(weights)
    z, y, x = np.indices(shape)
    block = (z // 2 * 100 + y // 2) * 100 + x // 2
    inside = []
    for d, w in enumerate(weights):
        # not from the last block to the first one, even if one voxel is all there is of both
        first = np.indices(shape)[2 - d] == 0
        inside.append(np.where((block == np.roll(block, 1, 2 - d)) & ~first, w, np.float32(0)))
    matrix = matrix_of(np.zeros(shape), inside)
    matrix.eliminate_zeros()
    count, label = connected_components(matrix, directed=False)
    there = grids.level.diagonal > 0
    pairs = {*zip(label[there].tolist(), grids.piece[there].tolist(), strict=True)}
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    assert (grids.piece[~there] == -1).all()
    assert count - np.count_nonzero(~there) == len(pairs)


def test_numbers_of_pieces_are_in_the_order_of_blocks():
    # two channels along x, beside each other in one block, and a wall between them
    wx = np.zeros((2, 2, 4), np.float32)
    wx[0, 0], wx[1, 1] = 1, 0.5
    none = np.zeros_like(wx)
    grids = ChannelGrids((wx, none, none))
    assert grids.piece.reshape(2, 2, 4)[0, 0].tolist() == [0, 0, 2, 2]
    assert grids.piece.reshape(2, 2, 4)[1, 1].tolist() == [1, 1, 3, 3]
    block = np.empty(8, np.int64)
    parts = [w.reshape(-1) for w in (wx, none, none)]
    assert pieces_of_blocks(grids.level.diagonal, *parts, grids.level.size, grids.piece, block) == 4
    assert block[:4].tolist() == [0, 0, 1, 1]
    # what drives one channel does not reach the other
    r = np.zeros(16)
    r[0], r[2] = 1, -1
    z = cycled(grids, r).reshape(2, 2, 4)
    assert (z[1, 1] == 0).all()
    assert z[0, 0, 0] > 0 > z[0, 0, 2]


@pytest.mark.parametrize(("shape", "seed"), [((12, 10, 9), 1), ((7, 16, 11), 2), ((1, 5, 30), 3), ((2, 2, 2), 4)])
def test_cycles_are_symmetric_and_positive(shape, seed):
    weights = random_weights(shape, seed)
    grids = ChannelGrids(weights)
    matrix = matrix_of(np.zeros(shape), weights)
    rng = np.random.default_rng(seed)
    f, g = (matrix @ rng.standard_normal(matrix.shape[0]) for _ in range(2))
    first, second = cycled(grids, f).astype(float), cycled(grids, g).astype(float)
    assert first @ g == pytest.approx(f @ second, rel=1e-4, abs=1e-4 * np.sqrt((f @ first) * (g @ second)))
    assert f @ first > 0
    assert g @ second > 0
    assert (first[grids.level.diagonal == 0] == 0).all()


def network(n, seed):
    """Weights of straight channels, one voxel wide, along all axes, of strengths over two orders of magnitude."""
    rng = np.random.default_rng(seed)
    weights = tuple(np.zeros((n, n, n), np.float32) for _ in range(3))
    for d, w in enumerate(weights):
        for a, b in rng.integers(0, n, (n, 2)):
            line = [a, b]
            line.insert(2 - d, slice(None))
            w[tuple(line)] = 10 ** rng.uniform(-2, 0)
    return weights


def test_channels_are_solved_for():
    weights = network(24, 5)
    grids = ChannelGrids(weights)
    assert len(grids.graphs) > 1
    assert grids.sizes[-1] <= 60
    matrix = matrix_of(np.zeros((24,) * 3), weights)
    wanted = np.random.default_rng(1).standard_normal(matrix.shape[0])
    b = matrix @ wanted
    # conjugate gradients: how the energy of the error falls
    x, r = np.zeros_like(b), b.copy()
    z = cycled(grids, r).astype(float)
    p, rz = z.copy(), r @ z
    for _ in range(12):
        q = matrix @ p
        x += rz / (p @ q) * p
        r -= rz / (p @ q) * q
        z = cycled(grids, r).astype(float)
        p, rz = z + r @ z / rz * p, r @ z
    error = x - wanted
    assert error @ (matrix @ error) < 1e-5 * (wanted @ b)


@pytest.mark.parametrize("net", [False, True])
def test_channels_apart_from_each_other_need_no_matrix(net):
    # a plane image with many pores, through each of which something flows across; of a net within the plane, as well
    shape, rng = (1, 66, 66), np.random.default_rng(7)
    weights = tuple(np.zeros(shape, np.float32) for _ in range(3))
    for j, i in [(0, 0), (0, 1), (1, 0), (1, 1)]:
        weights[2][0, j::6, i::6] = 0.1
        if i:
            weights[0][0, j::6, i::6] = 10 ** rng.uniform(-2, 0, (11, 11))
        if j:
            weights[1][0, j::6, i::6] = 10 ** rng.uniform(-2, 0, (11, 11))
    if net:
        weights[0][0, 3::22] = 1
        weights[1][0, :, 3] = 0.5
    grids = ChannelGrids(weights)
    assert grids.twice
    assert len(grids.graphs) > 0
    assert grids.sizes[0] >= 121
    # no graph but the first has unknowns that nothing joins
    for graph in grids.graphs[1:]:
        assert (graph.inverse > 0).all()
    assert grids.inverse.any(axis=1).all()
    assert net == (grids.sizes[-1] > 0)
    matrix = matrix_of(np.zeros(shape), weights)
    wanted = rng.standard_normal(matrix.shape[0])
    b = matrix @ wanted
    error = wanted - cycled(grids, b)
    assert error @ (matrix @ error) < 0.3 * (wanted @ b)
