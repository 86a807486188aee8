"""Points evened out by a pair potential: quiet at long waves of any direction, the spacing kept, no place special."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling.blocks import block_quotas, spacing_at_share, throw_blocks
from sppm_pipeline.method.sampling.evened import _Grid, _long_waves, even_out, near_the_rim

SIDE, PER_BLOCK = 4, 40
SPACING = spacing_at_share(PER_BLOCK, 0.5)


def darts(seed=1, shape=(SIDE,) * 3, periodic=True, per_block=PER_BLOCK, spacing=SPACING):
    quotas = block_quotas(np.ones(shape, bool), per_block)
    centers, first = throw_blocks(seed, quotas, spacing, periodic=periodic)
    block = np.repeat(np.arange(quotas.size), np.diff(first))
    return centers + np.stack(np.unravel_index(block, shape), 1)


def evened(points, *, moves=None, shape=(SIDE,) * 3, periodic=True, stealth=0.4, spacing=SPACING, threads=1):
    free = np.ones(len(points), bool) if moves is None else moves
    density = len(points) / np.prod(shape)
    return even_out(points, free, np.ones(shape, bool), periodic, density, stealth, spacing, threads)


@pytest.fixture(scope="module")
def cloud():
    return evened(darts())


def loudness(points, low, high):
    """Mean structure factor of the waves of the box between two wave numbers, periods over a block."""
    most = int(high * SIDE)
    k = np.stack(np.meshgrid(*[np.arange(-most, most + 1)] * 3), -1).reshape(-1, 3)
    length = np.linalg.norm(k, axis=1) / SIDE
    k = k[(length >= low) & (length <= high)]
    k = k[:: max(1, len(k) // 400)]
    return (np.abs(np.exp(-2j * np.pi / SIDE * (points @ k.T)).sum(0)) ** 2).mean() / len(points)


def test_long_waves_are_quiet_and_short_ones_are_not(cloud):
    points, factor = cloud
    limit = (9 * 0.4 * PER_BLOCK / (2 * np.pi)) ** (1 / 3)
    assert loudness(points, 0.2, 0.5 * limit) < 0.02 < 5 * 0.02 < loudness(darts(), 0.2, 0.5 * limit)
    assert loudness(points, 0.5 * limit, 0.8 * limit) < 0.04
    assert loudness(points, 1.2 * limit, 1.6 * limit) > 0.7
    assert 0 < factor < 0.1


def test_the_spacing_is_kept_and_pores_stay_disordered(cloud):
    points, _ = cloud
    assert 0 <= points.min() <= points.max() < SIDE
    nearest = cKDTree(points, boxsize=SIDE).query(points, k=2)[0][:, 1]
    assert nearest.min() >= SPACING
    assert nearest.std() > 0.03 * nearest.mean()  # none in a crystal


def test_no_place_of_the_blocks_differs_from_another():
    found = [evened(darts(seed))[0] for seed in range(4)]
    depth = np.concatenate([np.abs(points - np.round(points)) for points in found]).ravel()
    counts = np.histogram(depth, [0, 0.05, 0.1, 0.2, 0.35, 0.5])[0]
    expected = len(depth) * np.diff([0, 0.1, 0.2, 0.4, 0.7, 1.0])
    assert np.abs(counts / expected - 1).max() < 0.06  # independent points: 0.02 on average
    near, far = [], []
    for points in found:
        nearest = cKDTree(points, boxsize=SIDE).query(points, k=2)[0][:, 1]
        edge = np.abs(points - np.round(points)).min(1)
        near.append(nearest[edge < 0.05].mean())
        far.append(nearest[edge > 0.2].mean())
    assert np.mean(near) == pytest.approx(np.mean(far), rel=0.02)


def test_threads_change_no_byte_and_the_order_of_points_only_the_rounding(cloud):
    points, _ = cloud
    for threads in (2, 3):
        assert evened(darts(), threads=threads)[0].tobytes() == points.tobytes()
    order = np.random.default_rng(0).permutation(len(points))
    assert np.allclose(evened(darts()[order])[0], points[order], atol=1e-9)


def test_a_shift_of_all_points_shifts_the_result(cloud):
    """The potential knows no lattice: not even by half a block does the result differ, but for rounding."""
    points, _ = cloud
    shift = np.array([0.5, 0.25, 0.375])
    turned = (evened((darts() + shift) % SIDE)[0] - shift - points + SIDE / 2) % SIDE - SIDE / 2
    assert np.abs(turned).max() < 1e-9


def test_what_does_not_move_stays_and_the_room_is_not_left():
    room = np.ones((3, 2, 2), bool)
    room[2, 1] = False
    points = darts(2, (3, 2, 2), False)
    points = points[room[tuple(points.astype(int).T)]]
    moves = ~near_the_rim(points, room, 0.4)
    assert 0 < moves.sum() < len(points)
    distance = np.minimum(points, np.array(room.shape) - points).min(1)
    assert (distance[moves] >= 0.4).all()
    assert not moves[(points[:, 0] > 1.6) & (points[:, 1] > 0.6)].any()
    made, _ = even_out(points, moves, room, False, PER_BLOCK, 0.4, SPACING)
    np.testing.assert_array_equal(made[~moves], points[~moves])
    assert not np.allclose(made[moves], points[moves])
    assert room[tuple(made.astype(int).T)].all()
    assert cKDTree(made).query(made, k=2)[0][:, 1].min() >= SPACING
    everywhere, _ = even_out(points, np.zeros(len(points), bool), room, False, PER_BLOCK, 0.4, SPACING)
    assert everywhere is points


def test_forces_are_those_of_the_energy_images_included():
    points, direction = np.random.default_rng(0).random((7, 3)), np.random.default_rng(1).standard_normal((7, 3))
    grid, potential = _Grid(np.ones((1, 1, 1), bool), True, 1), _long_waves(9.0, 1.7)[0]
    energy, force = grid.sums(points, potential)
    step = 1e-4
    ahead, behind = (grid.sums((points + s * direction) % 1.0, potential)[0].sum() / 2 for s in (step, -step))
    assert (behind - ahead) / (2 * step) == pytest.approx((force * direction).sum(), rel=5e-3)  # of tables
    images = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3), -1).reshape(-1, 3)
    distance = np.linalg.norm(points[0] - (points[:, None] + images).reshape(-1, 3), axis=1)
    known = np.interp(distance**2, np.linspace(0, 1.7**2, len(potential.energy)), potential.energy, right=0)
    assert energy[0] == pytest.approx(known[distance > 0].sum(), abs=1e-9)


def test_pores_that_can_not_be_that_far_apart_are_refused():
    with pytest.raises(DesignError, match="can't be evened out"):
        evened(np.random.default_rng(0).random((30, 3)), shape=(1, 1, 1), spacing=0.5)
