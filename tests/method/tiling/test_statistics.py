"""Statistics of tilings: every kind of mistake is seen, and what can be counted one by one is."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.tiling.hashed import tile_hashed
from sppm_pipeline.method.tiling.statistics import (
    alike_neighbors,
    entropy_per_cell,
    face_violations,
    rule2_scores,
)
from sppm_pipeline.method.tiling.wang import tile_colors, tile_wang


def test_tiles_whose_opposite_faces_differ():
    six = np.array([[0, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
    others = np.zeros((3, 2, 1), np.int32), np.zeros((3, 1, 2), np.int32)
    for tiles, planes, broken in (([0, 1, 0], [0, 1, 0, 1], 0), ([0, 0, 1], [0, 1, 1, 0], 1)):
        faces = (np.array(planes, np.int32).reshape(4, 1, 1), *others)
        assert face_violations(np.array(tiles).reshape(3, 1, 1), faces, six).tolist() == [broken, 0, 0]


def test_missing_stray_and_wrong_faces_are_seen():
    mask = np.ones((3, 3, 3), bool)
    mask[0, 0, 0] = False
    interior, faces = tile_wang(mask, 0, 3)
    assert faces[0][0, 0, 0] == -1
    for place, value, expected in (((2, 1, 1), -1, 3), ((0, 0, 0), 1, 1), ((2, 1, 1), 77, 2)):
        changed = faces[0].copy()
        changed[place] = value
        broken = face_violations(interior, (changed, faces[1], faces[2]), tile_colors(3))
        assert broken.tolist() == [expected, 0, 0]


def test_ends_of_a_periodic_tiling_must_agree():
    interior, faces = tile_hashed(np.ones((4, 4, 4), bool), 3, 5, 1000)
    assert (face_violations(interior, faces, periodic=True) > 0).all()
    assert not face_violations(interior, faces).any()


def obvious_pairs(cells, periodic):
    """All ordered pairs of a cell and a neighbor: (cell, other, axes of the shift)."""
    for place in np.ndindex(cells.shape):
        for step in itertools.product((-1, 0, 1), repeat=3):
            other = np.add(place, step)
            if periodic:
                other %= cells.shape
            elif (other < 0).any() or (other >= cells.shape).any():
                continue
            if any(step) and cells[place] >= 0 and cells[tuple(other)] >= 0:
                yield place, tuple(other), sum(map(abs, step))


@pytest.mark.parametrize("shape", [(4, 3, 5), (1, 2, 3), (1, 1, 1)])
@pytest.mark.parametrize("periodic", [False, True])
def test_neighbors_are_counted_as_one_by_one(shape, periodic):
    cells = np.random.default_rng(3).integers(-1, 3, shape)
    alike, pairs = np.zeros(3, int), np.zeros(3, int)
    score, largest = np.zeros(shape, int), np.zeros(shape, int)
    for place, other, axes in obvious_pairs(cells, periodic):
        pairs[axes - 1] += 1
        alike[axes - 1] += cells[place] == cells[other]
        largest[place] += 4 - axes
        score[place] += (4 - axes) * (cells[place] != cells[other])
    found = alike_neighbors(cells, periodic=periodic)
    assert [(2 * count).tolist() for count in found] == [alike.tolist(), pairs.tolist()]
    for array, expected in zip(rule2_scores(cells, periodic=periodic), (score, largest), strict=True):
        np.testing.assert_array_equal(array, expected)


def test_inside_of_a_box_a_score_is_at_most_fifty():
    tiles = np.arange(27).reshape(3, 3, 3)
    score, largest = rule2_scores(tiles)
    assert score[1, 1, 1] == largest[1, 1, 1] == 6 * 3 + 12 * 2 + 8


def adjacent(mask, periodic):
    """All pairs of a cell and the next one along an axis, and that axis."""
    for axis in range(3):
        for place in np.argwhere(mask):
            other = place + (np.arange(3) == axis)
            if periodic:
                other %= mask.shape
            if other[axis] < mask.shape[axis] and mask[tuple(other)]:
                yield tuple(place), tuple(other), axis


def count_wang(mask, periodic):
    """Layouts of two colors that Rule 1 allows, by trying all."""
    pairs = list(adjacent(mask, periodic))
    places = list(zip(*np.nonzero(mask), strict=True))
    count = 0
    for chosen in itertools.product(range(8), repeat=len(places)):
        tile = dict(zip(places, chosen, strict=True))
        count += all(tile_colors(2)[tile[a], axis] == tile_colors(2)[tile[b], axis] for a, b, axis in pairs)
    return count


@pytest.mark.parametrize(
    "mask", [np.ones((2, 1, 1)), np.ones((2, 2, 1)), np.ones((3, 1, 1)), np.array([1, 0, 1]).reshape(3, 1, 1)]
)
@pytest.mark.parametrize("periodic", [False, True])
def test_entropy_of_the_papers_set_is_the_logarithm_of_what_rule_1_allows(mask, periodic):
    mask = mask.astype(bool)
    bits = entropy_per_cell(mask, "wang", 2, periodic=periodic) * mask.sum()
    assert 2**bits == pytest.approx(count_wang(mask, periodic))


@pytest.mark.parametrize(
    ("kind", "periodic", "colored"),
    [("free", False, 36), ("free", True, 24), ("corner", False, 27), ("corner", True, 8)],
)
def test_entropy_counts_faces_and_corners(kind, periodic, colored):
    bits = entropy_per_cell(np.ones((2, 2, 2)), kind, 5, 7, periodic=periodic)
    assert 8 * bits == pytest.approx(colored * math.log2(5) + 8 * math.log2(7))
    hole = np.ones((2, 2, 2))
    hole[0, 0, 0] = 0
    lost = {"free": 3, "corner": 1}[kind] if not periodic else 0
    bits = entropy_per_cell(hole, kind, 5, 7, periodic=periodic)
    assert 7 * bits == pytest.approx((colored - lost) * math.log2(5) + 7 * math.log2(7))


def test_entropy_of_large_boxes():
    box = np.ones((100, 100, 100), bool)
    assert entropy_per_cell(box, "wang", 3) == pytest.approx(3 * math.log2(3) / 100)
    assert entropy_per_cell(box, "free", 4, 8, periodic=True) == pytest.approx(9.0)
    assert entropy_per_cell(box, "corner", 4, 8, periodic=True) == pytest.approx(5.0)
    assert entropy_per_cell(np.zeros((1, 1, 1)), "free", 4) == 0.0


def test_wrong_kind_and_counts():
    with pytest.raises(ValueError, match="unknown kind"):
        entropy_per_cell(np.ones((2, 2, 2)), "hexagons", 2)
    with pytest.raises(DesignError, match="colors is 0"):
        entropy_per_cell(np.ones((2, 2, 2)), "corner", 0)
