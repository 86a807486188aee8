"""Measures of tetrahedra against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sppm_tetwild.quality import aspect_ratios, cell_volumes, dihedral_angles, non_manifold_faces

REGULAR = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
CELL = np.array([[0, 1, 2, 3]], np.int32)
CORNER = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def test_regular_tetrahedron():
    np.testing.assert_allclose(dihedral_angles(REGULAR, CELL), np.degrees(np.arccos(1 / 3)))
    np.testing.assert_allclose(aspect_ratios(REGULAR, CELL), 1)


def test_corner_of_a_cube():
    assert cell_volumes(CORNER, CELL)[0] == pytest.approx(1 / 6)
    assert cell_volumes(CORNER, CELL[:, [0, 2, 1, 3]])[0] == pytest.approx(-1 / 6)
    angles = np.sort(dihedral_angles(CORNER, CELL)[0])
    np.testing.assert_allclose(angles, [np.degrees(np.arctan(2**0.5))] * 3 + [90] * 3)
    radius = 1 / (3 + 3**0.5)
    assert aspect_ratios(CORNER, CELL)[0] == pytest.approx(2**0.5 / (2 * 6**0.5 * radius))


@settings(deadline=None, derandomize=True, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_measures_do_not_depend_on_place_size_or_numbering(seed):
    rng = np.random.default_rng(seed)
    nodes = rng.random((4, 3))
    if abs(cell_volumes(nodes, CELL)[0]) < 1e-3:
        return
    order = rng.permutation(4)
    other, cell = nodes[order] * 7 + rng.random(3), np.argsort(order).astype(np.int32)[None]
    for measure in (lambda *mesh: np.sort(dihedral_angles(*mesh)[0]), aspect_ratios):
        np.testing.assert_allclose(measure(nodes, CELL), measure(other, cell), rtol=1e-6)
    positive = nodes if cell_volumes(nodes, CELL)[0] > 0 else nodes[[0, 2, 1, 3]]
    assert aspect_ratios(positive, CELL)[0] >= 1 - 1e-9
    assert 0 < dihedral_angles(positive, CELL).min() <= np.degrees(np.arccos(1 / 3)) + 1e-9


def test_flat_tetrahedra_are_endlessly_bad():
    flat = CORNER * [1, 1, 0]
    assert aspect_ratios(flat, CELL)[0] == np.inf
    squashed = CORNER * [1, 1, 1e-9]
    assert dihedral_angles(squashed, CELL).min() < 1e-6


def test_overlapping_tetrahedra_are_found():
    cells = np.array([[0, 1, 2, 3], [0, 2, 1, 4]], np.int32)
    assert non_manifold_faces(cells) == 0
    assert non_manifold_faces(np.concatenate([cells, [[0, 1, 2, 5]]])) == 1
