"""Corner colors: faces and interiors follow from the lattice corners."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.tiling.corners import tile_corners
from sppm_pipeline.method.tiling.lattice import CORNER, INTERIOR, hash_places
from sppm_pipeline.method.tiling.statistics import face_violations

masks = hnp.arrays(np.bool_, hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=5))


def corner_color(seed, corner, colors, period):
    place = corner if period is None else corner % period
    return hash_places(seed, CORNER, *place)[0] % np.uint64(colors)


def digits(number, base, count):
    return [number // base**n % base for n in range(count)]


@settings(deadline=None, derandomize=True, max_examples=40)
@given(masks, st.integers(0, 2**64 - 1), st.integers(1, 5), st.booleans())
def test_faces_and_interiors_name_their_corners(mask, seed, colors, periodic):
    interior, faces = tile_corners(mask, seed, colors, periodic=periodic)
    period = mask.shape if periodic else None
    assert np.array_equal(interior >= 0, mask)
    assert not face_violations(interior, faces, periodic=periodic).any()
    for cell in np.argwhere(mask):
        named = digits(int(interior[tuple(cell)]), colors, 8)
        for position in range(8):
            corner = cell + np.array([position & 1, position >> 1 & 1, position >> 2 & 1])
            assert named[position] == corner_color(seed, corner, colors, period)
    for axis in range(3):
        along = [a for a in range(3) if a != axis]
        for face in np.argwhere(faces[axis] >= 0):
            named = digits(int(faces[axis][tuple(face)]), colors, 4)
            for position in range(4):
                corner = face.copy()
                corner[along] += [position & 1, position >> 1]
                assert named[position] == corner_color(seed, corner, colors, period)


def test_all_combinations_occur():
    interior, faces = tile_corners(np.ones((24, 24, 24), bool), 0, 2)
    assert set(interior.ravel().tolist()) == set(range(256))
    for axis in range(3):
        counts = np.bincount(faces[axis].ravel(), minlength=16)
        assert counts.size == 16
        assert counts.min() > 0.8 * faces[axis].size / 16


def test_given_number_of_interiors_is_drawn_as_for_free_faces():
    mask = np.ones((5, 4, 3), bool)
    interior, _ = tile_corners(mask, 6, 2, interiors=40)
    assert np.array_equal(interior.ravel(), hash_places(6, INTERIOR, *np.argwhere(mask).T) % np.uint64(40))


@pytest.mark.parametrize(("colors", "interiors"), [(0, None), (15, None), (216, 4), (2, 0)])
def test_numbers_that_do_not_fit_are_refused(colors, interiors):
    with pytest.raises(DesignError, match="number of"):
        tile_corners(np.ones((2, 2, 2), bool), 0, colors, interiors)


def test_largest_numbers_fit():
    interior, _ = tile_corners(np.ones((3, 3, 3), bool), 0, 14)
    assert interior.min() >= 0
    _, faces = tile_corners(np.ones((3, 3, 3), bool), 0, 215, 1)
    assert faces[0].min() >= 0
