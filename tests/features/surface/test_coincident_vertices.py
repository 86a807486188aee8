"""Coincident vertices are moved apart, each to its own side."""

from __future__ import annotations

import numpy as np

from sppm_pipeline.features.surface.solids import (
    coincident_vertices,
    run_level_set,
    separate_coincident_vertices,
)
from sppm_pipeline.services.mesh.measures import edge_counts, volume

TIP = np.array([[0, 0, 0], [1, 0, 2], [-1, 1, 2], [-1, -1, 2]], float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], np.int32)
ABOVE, BELOW = TIP, TIP * [-1, 1, -1]
BOX = np.full(3, -9.0), np.full(3, 9.0)


def test_two_tips_draw_back():
    vertices = np.concatenate([ABOVE, BELOW])
    faces = np.concatenate([FACES, FACES + 4])
    assert coincident_vertices(vertices).tolist() == [0, 4]
    moved = separate_coincident_vertices(vertices, faces, *BOX)
    assert moved[0, 2] > 0 > moved[4, 2]
    assert np.abs(moved - vertices).max() < 0.01
    assert np.array_equal(np.delete(moved, [0, 4], 0), np.delete(vertices, [0, 4], 0))
    assert len(coincident_vertices(moved)) == 0
    turned = separate_coincident_vertices(vertices, faces[:, ::-1], *BOX)
    assert np.array_equal(turned, moved)  # tips of void draw back the same way


def test_caps_stay_in_the_box_and_tips_that_touch_it_draw_back():
    """A tip of void above the bottom of the box, and solid that stands on it, with a corner at the same place."""
    cap = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 1, 2]], float)
    vertices, faces = np.concatenate([ABOVE, cap]), np.concatenate([FACES, FACES + 4])
    for turn in (1, -1):  # the bottom, then the top
        low, high = (np.array([-9.0, -9, 0]), BOX[1]) if turn > 0 else (BOX[0], np.array([9.0, 9, 0]))
        moved = separate_coincident_vertices(vertices * [1, 1, turn], faces, low, high)
        assert moved[0, 2] * turn > 0
        assert moved[4, 2] == 0
        assert (moved[4, :2] > 0).all()


def test_nothing_to_do():
    moved = separate_coincident_vertices(ABOVE, FACES, *BOX)
    assert np.array_equal(moved, ABOVE)


def test_noise_survives_a_file_without_indices():
    """The native extractor leaves coincident vertices and flat triangles in noise."""
    samples = np.random.default_rng(3).standard_normal((41, 41, 41)).astype(np.float32)
    (vertices, faces), status = run_level_set(samples, (0.0, 0.0, 0.0), 0.1)
    assert status == "NoError"
    single, place = np.unique(vertices.astype(np.float32), axis=0, return_inverse=True)
    merged = place.reshape(-1)[faces]
    assert len(single) == len(vertices)
    assert edge_counts(merged).closed
    assert volume(single.astype(np.float64), merged) > 0
