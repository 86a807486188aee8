"""The paper's tiling: Rule 1 at every adjacency, Rule 2 against an obvious greedy filler."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.tiling.lattice import TIE, hash_places
from sppm_pipeline.method.tiling.statistics import face_violations, rule2_scores
from sppm_pipeline.method.tiling.wang import tile_colors, tile_wang

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6))


def greedy(mask, seed, colors, scored, periodic):
    """Rule 1 by looking at whole runs, Rule 2 by scoring every tile against all 26 neighbors."""
    shape = mask.shape
    tiles = np.full(shape, -1)
    table = tile_colors(colors)
    for k in range(shape[2]):
        for j in range(shape[1]):
            for i in range(shape[0]):
                if not mask[i, j, k]:
                    continue
                allowed = list(range(colors**3))
                for axis in range(3):
                    for step in (-1, 1):
                        cell = [i, j, k]
                        for _ in range(shape[axis]):
                            cell[axis] += step
                            if periodic:
                                cell[axis] %= shape[axis]
                            if not 0 <= cell[axis] < shape[axis] or not mask[tuple(cell)]:
                                break
                            if tiles[tuple(cell)] >= 0:
                                shown = table[tiles[tuple(cell)], axis]
                                allowed = [t for t in allowed if table[t, axis] == shown]
                scores = []
                for tile in allowed:
                    score = 0
                    for step in np.ndindex(3, 3, 3):
                        offset = np.array(step) - 1
                        cell = np.array([i, j, k]) + offset
                        if periodic:
                            cell %= shape
                        if not offset.any() or (cell < 0).any() or (cell >= shape).any():
                            continue
                        neighbor = tiles[tuple(cell)]
                        if neighbor >= 0 and neighbor != tile:
                            score += 4 - abs(offset).sum()
                    scores.append(score if scored else 0)
                best = [t for t, s in zip(allowed, scores, strict=True) if s == max(scores)]
                draw = int(hash_places(seed, TIE, i, j, k)[0])
                tiles[i, j, k] = best[draw % len(best)]
    return tiles


@settings(deadline=None, derandomize=True, max_examples=60)
@given(masks, st.integers(0, 2**64 - 1), st.integers(1, 4), st.booleans(), st.booleans())
def test_rule_1_holds_at_every_adjacency_of_any_mask(mask, seed, colors, scored, periodic):
    interior, faces = tile_wang(mask, seed, colors, scored=scored, periodic=periodic)
    assert np.array_equal(interior >= 0, mask)
    assert not face_violations(interior, faces, tile_colors(colors), periodic=periodic).any()


@settings(deadline=None, derandomize=True, max_examples=25)
@given(
    hnp.arrays(np.bool_, hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=4)),
    st.integers(0, 2**64 - 1),
    st.integers(1, 3),
    st.booleans(),
    st.booleans(),
)
def test_compiled_filler_equals_greedy(mask, seed, colors, scored, periodic):
    interior, _ = tile_wang(mask, seed, colors, scored=scored, periodic=periodic)
    assert np.array_equal(interior, greedy(mask, seed, colors, scored, periodic))


@pytest.mark.parametrize("periodic", [False, True])
def test_compiled_filler_equals_greedy_on_a_box(periodic):
    mask = np.ones((5, 4, 3), bool)
    interior, _ = tile_wang(mask, 11, 3, periodic=periodic)
    assert np.array_equal(interior, greedy(mask, 11, 3, True, periodic))


def test_worked_example_of_the_paper():
    # The sixth cell of a 2 x 2 x 2 structure: two neighbors across faces, two across edges, one across a corner.
    number = {tuple(row): n for n, row in enumerate(tile_colors(3))}
    low_x, low_z = number[0, 0, 0], number[1, 2, 1]  # so the new tile is (0, any, 1)
    corner = number[0, 1, 1]  # T1 equals P1
    tiles = np.full((2, 2, 2), -1)
    tiles[0, 0, 1] = number[0, 2, 1]  # F1, which T2 equals
    tiles[1, 0, 0] = low_z  # F2
    tiles[0, 0, 0], tiles[1, 1, 0] = low_x, number[1, 1, 0]  # L1, L2
    tiles[0, 1, 0] = corner  # P1
    scores = []
    for tile in ((0, 1, 1), (0, 2, 1), (0, 0, 1)):
        tiles[1, 0, 1] = number[tile]
        scores.append(rule2_scores(tiles)[0][1, 0, 1])
    assert scores == [10, 8, 11]


def test_rule_2_separates_equal_tiles():
    mask = np.ones((12, 12, 12), bool)
    equal = {}
    for scored in (False, True):
        tiles, _ = tile_wang(mask, 3, 3, scored=scored)
        equal[scored] = sum(np.count_nonzero(np.diff(tiles, axis=axis) == 0) for axis in range(3))
    assert equal[True] < equal[False]


def test_a_run_that_meets_itself_around_the_end():
    # Cells 0-1 and 3-4 are one run of a periodic row although cell 2 is missing.
    mask = np.array([True, True, False, True, True])[:, None, None]
    for seed in range(20):
        _, faces = tile_wang(mask, seed, 3, periodic=True)
        colors = faces[0].ravel()
        assert len(set(colors.tolist())) == 1
    split = {tuple(tile_wang(mask, seed, 3)[1][0].ravel()) for seed in range(20)}
    assert any(row[0] != row[-1] for row in split)


def test_opposite_ends_of_a_full_box_agree_anyway():
    _, faces = tile_wang(np.ones((4, 3, 5), bool), 1, 3)
    for axis in range(3):
        assert np.array_equal(np.take(faces[axis], 0, axis), np.take(faces[axis], -1, axis))


def test_same_seed_same_tiling_other_seed_another():
    mask = np.ones((7, 5, 6), bool)
    first, again, other = (tile_wang(mask, seed, 3)[0] for seed in (5, 5, 6))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_first_cell_is_drawn_from_all_tiles():
    first = {int(tile_wang(np.ones((1, 1, 1), bool), seed, 3)[0].item()) for seed in range(400)}
    assert first == set(range(27))


def test_all_tiles_of_the_paper_are_used():
    tiles, _ = tile_wang(np.ones((20, 20, 20), bool), 0, 3)
    share = np.bincount(tiles.ravel(), minlength=27) / tiles.size
    assert share.min() > 0.5 / 27
    assert share.max() < 2.0 / 27


def test_a_million_cells_follow_rule_1():
    tiles, faces = tile_wang(np.ones((100, 100, 100), bool), 9, 3)
    assert not face_violations(tiles, faces, tile_colors(3)).any()


@pytest.mark.parametrize("colors", [0, -1, 1291])
def test_impossible_number_of_colors_is_refused(colors):
    with pytest.raises(DesignError, match=str(colors)):
        tile_wang(np.ones((2, 2, 2), bool), 0, colors)


@pytest.mark.parametrize("shape", [(3, 3), (3, 0, 3)])
def test_a_mask_must_have_three_axes(shape):
    with pytest.raises(ValueError, match="mask"):
        tile_wang(np.ones(shape, bool), 0)
