"""Free face colors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.tiling.hashed import tile_hashed
from sppm_pipeline.method.tiling.lattice import FACE, INTERIOR, hash_places
from sppm_pipeline.method.tiling.statistics import face_violations

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=6))


def chi_square(values, bins):
    """Pearson's statistic in standard deviations above its mean."""
    counts = np.bincount(values.ravel(), minlength=bins)
    expected = values.size / bins
    return (((counts - expected) ** 2 / expected).sum() - (bins - 1)) / np.sqrt(2 * (bins - 1))


@settings(deadline=None, derandomize=True, max_examples=50)
@given(masks, st.integers(0, 2**64 - 1), st.integers(1, 70), st.integers(1, 20), st.booleans())
def test_every_cell_and_face_is_drawn_by_its_place_alone(mask, seed, interiors, colors, periodic):
    interior, faces = tile_hashed(mask, seed, interiors, colors, periodic=periodic)
    assert np.array_equal(interior >= 0, mask)
    assert not face_violations(interior, faces, periodic=periodic).any()
    drawn = hash_places(seed, INTERIOR, *np.argwhere(mask).T) % np.uint64(interiors)
    assert np.array_equal(interior[mask], drawn)
    for axis in range(3):
        there = np.argwhere(faces[axis] >= 0)
        drawn = hash_places(seed, FACE + axis, *(there % mask.shape if periodic else there).T) % np.uint64(colors)
        assert np.array_equal(faces[axis][faces[axis] >= 0], drawn)


@pytest.mark.parametrize("bins", [2, 3, 16, 27, 64])
def test_draws_are_uniform(bins):
    interior, faces = tile_hashed(np.ones((40, 40, 40), bool), 4, bins, bins)
    for values in (interior, *faces):
        assert abs(chi_square(values, bins)) < 6


def test_interiors_and_faces_are_independent():
    interior, faces = tile_hashed(np.ones((40, 40, 40), bool), 4, 4, 4)
    pair = interior * 16 + faces[0][:-1] * 4 + faces[1][:, :-1]
    assert abs(chi_square(pair, 64)) < 6


def test_neighboring_faces_are_independent():
    _, faces = tile_hashed(np.ones((40, 40, 40), bool), 8, 1, 5)
    for axis in range(3):
        planes = np.moveaxis(faces[axis], axis, 0)
        assert abs(chi_square(planes[:-1] * 5 + planes[1:], 25)) < 6


def test_opposite_faces_of_a_cell_may_differ():
    _, faces = tile_hashed(np.ones((4, 4, 4), bool), 0, 1, 3)
    assert (faces[0][:-1] != faces[0][1:]).any()


def test_a_part_of_a_larger_tiling_is_the_same_tiling():
    small, _ = tile_hashed(np.ones((3, 4, 5), bool), 2, 9, 3)
    large, _ = tile_hashed(np.ones((9, 8, 7), bool), 2, 9, 3)
    assert np.array_equal(small, large[:3, :4, :5])


@pytest.mark.parametrize(("interiors", "colors"), [(0, 3), (3, 0)])
def test_nothing_to_draw_from_is_refused(interiors, colors):
    with pytest.raises(DesignError, match="is 0"):
        tile_hashed(np.ones((2, 2, 2), bool), 0, interiors, colors)
