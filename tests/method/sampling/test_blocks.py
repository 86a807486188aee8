"""Pores thrown into a lattice of blocks by quota: counts, spacing across blocks, and every region alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.sampling import blocks
from sppm_pipeline.method.sampling.blocks import (
    block_colors,
    block_quotas,
    spacing_at_share,
    throw_blocks,
)
from sppm_pipeline.method.sampling.darts import throw
from sppm_pipeline.method.tiling.lattice import dilated


def placed(centers, first, shape):
    """Positions in the lattice."""
    return centers + np.repeat(np.argwhere(np.ones(shape, bool)), np.diff(first), axis=0)


def smallest_distance(points, shape, periodic):
    period = np.array(shape, float) if periodic else None
    folded = points % period if periodic else points
    return cKDTree(folded, boxsize=period).query(folded, k=2)[0][:, 1].min()


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**64 - 1),
    shape=st.tuples(*[st.integers(1, 5)] * 3),
    periodic=st.booleans(),
    mean=st.floats(3.0, 30.0),
    share=st.floats(0.2, 0.75),
    holes=st.booleans(),
)
def test_quotas_and_spacing_hold_in_every_block_and_across(seed, shape, periodic, mean, share, holes):
    mask = np.random.default_rng(seed).random(shape) < 0.7 if holes else np.ones(shape, bool)
    mask.flat[0] = True
    quotas, spacing = block_quotas(mask, mean), spacing_at_share(mean, share)
    centers, first = throw_blocks(seed, quotas, spacing, periodic=periodic)
    assert (np.diff(first) == quotas.ravel()).all()
    assert centers.min() >= 0
    assert centers.max() < 1
    assert smallest_distance(placed(centers, first, shape), shape, periodic) >= spacing


def test_quotas_are_the_mean_at_any_place_and_do_not_depend_on_the_mask():
    mask = np.ones((5, 4, 7), bool)
    quotas = block_quotas(mask, 12.3)
    assert set(np.unique(quotas)) == {12, 13}
    in_order = quotas.transpose(2, 1, 0).ravel()
    assert np.abs(np.cumsum(in_order) - 12.3 * np.arange(1, mask.size + 1)).max() <= 0.5 + 1e-9
    mask[1:3] = False
    assert (block_quotas(mask, 12.3) == np.where(mask, quotas, 0)).all()


@pytest.mark.parametrize("shape", [(4, 6, 2), (5, 3, 7), (1, 2, 3), (1, 1, 1)])
@pytest.mark.parametrize("periodic", [False, True])
def test_neighbors_never_share_a_color(shape, periodic):
    colors = block_colors(shape, periodic)
    assert colors.max() < 8 or (periodic and any(n % 2 for n in shape))
    places = [np.array(place) for place in np.ndindex(shape)]
    for a in places:
        for b in places:
            gap = np.abs(a - b)
            if periodic:
                gap = np.minimum(gap, shape - gap)
            if 0 < gap.max() <= 1:
                assert colors[tuple(a)] != colors[tuple(b)]


def needed_blocks(wanted):
    """The wanted blocks (nx, ny, nz) and all that they depend on: neighbors of earlier colors, and so on."""
    colors = block_colors(wanted.shape)
    needed = wanted.copy()
    for color in range(int(colors.max()), 0, -1):
        needed |= dilated(needed & (colors == color)) & (colors < color)
    return needed


def test_any_region_can_be_thrown_alone():
    """With no more than a halo of 4, 2 and 1 blocks, whatever the size of the lattice."""
    shape = (14, 9, 6)
    quotas = block_quotas(np.ones(shape, bool), 9.5)
    spacing = spacing_at_share(9.5, 0.7)
    whole, first = throw_blocks(3, quotas, spacing)
    largest = np.zeros(3, int)
    for place in [(0, 0, 0), (5, 3, 3), (6, 3, 3), (6, 4, 3), (7, 4, 3), (7, 5, 2), (13, 8, 5)]:
        wanted = np.zeros(shape, bool)
        wanted[place] = True
        needed = needed_blocks(wanted)
        alone, begin = throw_blocks(3, np.where(needed, quotas, 0), spacing)
        i = np.ravel_multi_index(place, shape)
        assert alone[begin[i] : begin[i + 1]].tobytes() == whole[first[i] : first[i + 1]].tobytes()
        largest = np.maximum(largest, np.abs(np.argwhere(needed) - place).max(0))
    assert (largest <= (4, 2, 1)).all()
    assert largest[0] == 4  # the halo is not stated larger than it is


def test_a_region_needs_all_it_is_said_to_need():
    """Without one block of the halo the pores of the region change: it does depend on it."""
    shape, place = (14, 9, 6), (6, 5, 3)
    wanted = np.zeros(shape, bool)
    wanted[place] = True
    needed = needed_blocks(wanted)
    quotas = block_quotas(needed, 30)
    spacing = spacing_at_share(30, 0.75)
    i = np.ravel_multi_index(place, shape)
    whole, first = throw_blocks(1, quotas, spacing)
    beside = np.argwhere(needed & dilated(wanted) & ~wanted)
    assert len(beside)
    for other in beside:
        fewer = quotas.copy()
        fewer[tuple(other)] = 0
        centers, begin = throw_blocks(1, fewer, spacing)
        if centers[begin[i] : begin[i + 1]].tobytes() != whole[first[i] : first[i + 1]].tobytes():
            return
    pytest.fail("no neighbor matters")


@pytest.mark.parametrize("periodic", [False, True])
def test_threads_change_no_byte(periodic):
    quotas = block_quotas(np.ones((5, 6, 3), bool), 21.7)
    one, _ = throw_blocks(8, quotas, 0.2, periodic=periodic)
    for threads in (2, 5):
        assert throw_blocks(8, quotas, 0.2, periodic=periodic, threads=threads)[0].tobytes() == one.tobytes()
    assert throw_blocks(9, quotas, 0.2, periodic=periodic)[0].tobytes() != one.tobytes()


def test_the_order_of_blocks_within_a_color_changes_no_byte(monkeypatch):
    quotas = block_quotas(np.ones((4, 6, 3), bool), 25)
    whole, _ = throw_blocks(8, quotas, 0.2, periodic=True)
    asked = []

    def backwards(throw, parts, threads):
        asked.append(np.concatenate(parts))
        return map(throw, [part[::-1] for part in reversed(parts)])

    monkeypatch.setattr(blocks, "ordered_map", backwards)
    assert throw_blocks(8, quotas, 0.2, periodic=True, threads=5)[0].tobytes() == whole.tobytes()
    assert sorted(np.concatenate(asked)) == list(range(72))


def test_a_lone_periodic_block_is_a_thrown_cell():
    """Same rules as a cell thrown alone: the same number of neighbors at the distances that the spacing decides."""

    def near(centers):
        return len(cKDTree(centers, boxsize=1.0).query_pairs(0.27)) / len(centers)

    quotas = block_quotas(np.ones((1, 1, 1), bool), 40)
    there = [near(throw_blocks(seed, quotas, 0.2, periodic=True)[0]) for seed in range(150)]
    upper = [1.0, 1.0, 1.0]
    here = [
        near(throw(np.random.default_rng(seed), 40, 0.2, [0.0] * 3, upper, periodic=(True,) * 3)) for seed in range(150)
    ]
    error = np.hypot(np.std(there), np.std(here)) / np.sqrt(150)
    assert abs(np.mean(there) - np.mean(here)) < 4 * error


def test_no_place_in_a_block_is_preferred():
    """Folded onto one block the pores are spread evenly, corners and faces included."""
    quotas = block_quotas(np.ones((16, 16, 16), bool), 20)
    centers, _ = throw_blocks(0, quotas, 0.22)
    counts, _ = np.histogramdd(centers, bins=[4] * 3, range=[(0, 1)] * 3)
    # blue noise varies less than independent points, whose counts vary by their root
    assert np.abs(counts / counts.mean() - 1).max() < 4 / np.sqrt(counts.mean())


def test_pores_thrown_before_are_kept_away_from():
    shape = (3, 2, 4)
    mask = np.ones(shape, bool)
    old = throw_blocks(1, block_quotas(mask, 8), 0.2, periodic=True)
    new = throw_blocks(2, block_quotas(mask, 25), 0.2, periodic=True, before=old)
    points = np.concatenate([placed(*old, shape), placed(*new, shape)])
    assert len(points) == 33 * mask.size
    assert smallest_distance(points, shape, True) >= 0.2


def test_what_does_not_fit_is_refused():
    quotas = block_quotas(np.ones((2, 2, 2), bool), 20)
    with pytest.raises(DesignError, match="block: it holds about"):
        throw_blocks(0, quotas, 0.4)
    with pytest.raises(DesignError, match="at most 1"):
        throw_blocks(0, quotas, 1.2)
    # all of it within the capacity of an infinite packing, but not in every single block
    with pytest.raises(DesignError, match=r"fit into the block \(.*blocks are too full"):
        throw_blocks(0, block_quotas(np.ones((4, 4, 4), bool), 60), spacing_at_share(60, 1.0), periodic=True)


def test_the_same_density_everywhere_throws_pores_of_the_same_quotas_and_spacing():
    quotas = block_quotas(np.ones((3, 4, 2), bool), 20.3, np.full((13, 17, 9), 1.0))
    assert (quotas == block_quotas(np.ones((3, 4, 2), bool), 20.3)).all()
    centers, first = throw_blocks(5, quotas, 0.22, density=np.full((13, 17, 9), 0.8))
    assert (np.diff(first) == quotas.ravel()).all()
    assert smallest_distance(placed(centers, first, quotas.shape), quotas.shape, False) >= 0.22 * 0.8 ** (-1 / 3)
