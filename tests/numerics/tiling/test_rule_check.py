"""The judge of tilings must see every kind of mistake."""

from __future__ import annotations

import numpy as np
import pytest

from sppm_pipeline.numerics.tiling.hashed import tile_hashed
from sppm_pipeline.numerics.tiling.rule_check import face_violations, rule1_violations
from sppm_pipeline.numerics.tiling.wang import tile_colors, tile_wang


def test_counts_each_broken_adjacency_once():
    tiles = np.zeros((3, 3, 3), np.int32)
    tiles[1, 1, 1] = 26  # differs from its six neighbors along every axis
    assert rule1_violations(tiles, tile_colors(3)).tolist() == [2, 2, 2]
    tiles[1, 1, 1] = 9  # (1, 0, 0): differs along x only
    assert rule1_violations(tiles, tile_colors(3)).tolist() == [2, 0, 0]


def test_missing_cells_have_no_adjacency():
    tiles = np.array([0, -1, 26]).reshape(3, 1, 1)
    assert not rule1_violations(tiles, tile_colors(3)).any()
    assert rule1_violations(tiles, tile_colors(3), periodic=True).tolist() == [1, 0, 0]


def test_tiles_whose_opposite_faces_differ():
    six = np.array([[0, 1, 0, 0, 0, 0], [1, 0, 0, 0, 0, 0]])
    assert not rule1_violations(np.array([0, 1, 0]).reshape(3, 1, 1), six).any()
    assert rule1_violations(np.array([0, 0, 1]).reshape(3, 1, 1), six).tolist() == [1, 0, 0]


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


def test_wrong_arguments():
    interior, faces = tile_hashed(np.ones((2, 2, 2), bool), 3, 40, 2)
    with pytest.raises(ValueError, match="faces across axis 0"):
        face_violations(interior, (faces[1], faces[1], faces[2]))
    with pytest.raises(ValueError, match="within"):
        rule1_violations(np.full((1, 1, 1), 27), tile_colors(3))
    with pytest.raises(ValueError, match="shape"):
        rule1_violations(interior, np.zeros((4, 5)))
