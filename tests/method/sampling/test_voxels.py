"""Active voxels with lists of points: the same pores as by asking the whole cell list for every dart and every part."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from sppm_pipeline.method.sampling.active_voxels import fill_active_voxels
from sppm_pipeline.method.sampling.cell_list import add_point, add_points, empty_cell_list, is_free, next_uniform
from sppm_pipeline.method.sampling.voxels import all_voxels, halved

CASES = [  # lower, side, periodic, spacing
    ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (True, True, True), 0.31),
    ((0.1, 0.2, 0.0), (0.8, 0.5, 0.7), (False, False, False), 0.24),
    ((0.2, 0.0, 0.1), (0.6, 1.0, 0.3), (True, True, False), 0.45),
    ((0.15, 0.0, 0.15), (0.7, 0.0, 0.7), (True, True, True), 0.2),
    ((0.0, 0.5, 0.5), (1.0, 0.0, 0.0), (False, True, False), 0.13),
]


def covered(cells, middle, half, family, member):
    """True if all of a voxel lies nearer to one point than the spacing."""
    n = cells.used[0]
    gap = np.abs(cells.points[:n] - middle)
    gap = np.where(np.isfinite(cells.period), np.minimum(gap, np.abs(cells.period - gap)), gap) + half
    counts = (cells.family[:n] != family) | (cells.member[:n] == member)
    x, y, z = gap.T
    return bool(((x * x + y * y + z * z < cells.reach**2) & counts).any())


def filled(cells, stream, lower, side, wanted, family, member):
    """The fill in plain words: every dart and every part of a voxel asks the cell list."""
    flat = side == 0
    parts = np.where(flat, 1, np.ceil(side / (cells.reach / np.sqrt(max(1, (~flat).sum()))))).astype(int)
    edge = np.where(flat, 0.0, side / parts)
    voxels = [np.zeros(3, int)]
    placed = 0
    while placed < wanted:
        split = []
        for voxel in voxels:
            for c, b, a in itertools.product(*(range(n) for n in parts[::-1])):
                place = voxel * parts + (a, b, c)
                if not covered(cells, lower + place * edge + edge / 2, edge / 2, family, member):
                    split.append(place)
        voxels = split
        if not voxels or edge[~flat].min() <= 1e-9 * cells.reach:
            break
        for _ in range(len(voxels)):
            voxel = voxels[min(int(next_uniform(stream) * len(voxels)), len(voxels) - 1)]
            spot = lower + voxel * edge
            for axis in np.flatnonzero(~flat):
                spot[axis] += edge[axis] * next_uniform(stream)
            inside = (spot < lower + side)[~flat].all()
            if inside and is_free(cells, tuple(spot), family, member):
                add_point(cells, *spot, family, member)
                placed += 1
                if placed == wanted:
                    return placed
        parts = np.where(flat, 1, 2)
        edge = edge / parts
    return placed


def some_points(seed, lower, side, spacing, periodic):
    """A cell list with obstacles, some of them dense and some of another member."""
    rng = np.random.default_rng(seed)
    low, side = np.array(lower), np.array(side)
    cells = empty_cell_list(400, spacing, low, low + side, periodic)
    around = np.where(periodic, rng.random((12, 3)), low - spacing + rng.random((12, 3)) * (side + 2 * spacing))
    add_points(cells, around[:6], -1, 0)
    add_points(cells, around[6:], 0, 1)
    dense = low + side / 2 + 0.02 * rng.random((40, 3))
    add_points(cells, dense, -1, 0)
    return cells, low, side


@pytest.mark.parametrize("case", range(len(CASES)))
@pytest.mark.parametrize("wanted", [3, 10**6])
def test_the_fill_is_that_of_plain_words(case, wanted):
    lower, side, periodic, spacing = CASES[case]
    made = []
    for fill in (filled, fill_active_voxels):
        cells, low, sides = some_points(case, lower, side, spacing, periodic)
        stream = np.array([17], np.uint64)
        placed = fill(cells, stream, low, sides, min(wanted, 300), 0, 0)
        made.append((placed, cells.points[: cells.used[0]].copy(), stream[0]))
    assert made[0][0] == made[1][0] > 0
    assert np.array_equal(made[0][1], made[1][1])
    assert made[0][2] == made[1][2]


@pytest.mark.parametrize("case", range(len(CASES)))
def test_voxels_list_every_point_that_reaches_into_them(case):
    lower, side, periodic, spacing = CASES[case]
    cells, low, sides = some_points(case, lower, side, spacing, periodic)
    roots = tuple(int(n) for n in np.where(sides > 0, np.ceil(1.8 * sides / spacing), 1))
    edge = np.where(sides > 0, sides / roots, 0.0)
    wide, parts = tuple(edge), np.where(sides > 0, 2, 1)
    voxels = all_voxels(cells, low, wide, roots, 0, 0)
    for _ in range(2):
        assert voxels.number > 0
        known = cells.used[0]
        for row in range(voxels.number):
            middle = low + voxels.places[row] * edge + edge / 2
            gap = np.abs(cells.points[:known] - middle)
            gap = np.where(periodic, np.minimum(gap, np.abs(1 - gap)), gap)
            counts = (cells.family[:known] != 0) | (cells.member[:known] == 0)
            reaching = (np.maximum(gap - edge / 2, 0) ** 2).sum(1) < cells.reach**2
            listed = voxels.points[voxels.first[row] : voxels.first[row + 1]]
            assert len(set(listed)) == len(listed)
            assert set(np.flatnonzero(reaching & counts)) <= set(listed)
            assert not (((gap + edge / 2) ** 2).sum(1)[counts] < cells.reach**2).any()
        add_points(cells, low + sides * np.random.default_rng(case).random((2, 3)), 0, 0)
        edge = edge / parts
        voxels = halved(cells, voxels, low, edge, parts, roots, wide, known)
