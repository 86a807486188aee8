"""Measures of tetrahedra against known ones."""

import numpy as np
import pytest
from sppm_tetrahedra.numerics.quality import dihedral_extremes, dihedral_histogram, quality, volumes

REGULAR = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], float)[[0, 2, 1, 3]]
CORNER = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
ONE = np.array([[0, 1, 2, 3]])


def test_the_regular_tetrahedron():
    found = quality(REGULAR * 3.7 + 100, ONE)
    assert found.minimum_dihedral == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found.maximum_dihedral == pytest.approx(np.degrees(np.arccos(1 / 3)))
    assert found.radius_ratio == pytest.approx(1)
    assert found.edge_ratio == pytest.approx(1)
    assert found.volume == pytest.approx(8 / 3 * 3.7**3)
    assert found.inverted == 0


def test_the_corner_of_a_cube():
    found = quality(CORNER, ONE)
    assert found.minimum_dihedral == pytest.approx(np.degrees(np.arctan(np.sqrt(2))))
    assert found.maximum_dihedral == pytest.approx(90)
    # circumradius sqrt(3)/2, inradius 3 V / A = 0.5 / (1.5 + sqrt(3)/2)
    assert found.radius_ratio == pytest.approx(np.sqrt(3) / 2 * (1.5 + np.sqrt(3) / 2) / 1.5)
    assert found.edge_ratio == pytest.approx(np.sqrt(2))


def test_angles_add_up_as_the_slow_way_says():
    rng = np.random.default_rng(0)
    nodes, tets = rng.random((60, 3)), rng.permutation(60).reshape(15, 4)
    angles, signed = [], []
    for a, b, c, d in nodes[tets]:
        signed.append(np.linalg.det([b - a, c - a, d - a]) / 6)
        points = np.array([a, b, c, d])
        for i in range(4):
            for j in range(i):
                k, m = (x for x in range(4) if x not in (i, j))
                edge = points[j] - points[i]
                edge /= np.linalg.norm(edge)
                u, v = (w - (w @ edge) * edge for w in (points[k] - points[i], points[m] - points[i]))
                angles.append(np.degrees(np.arccos(u @ v / np.linalg.norm(u) / np.linalg.norm(v))))
    angles = np.array(angles).reshape(15, 6)
    signed = np.array(signed)
    assert np.allclose(volumes(nodes, tets), signed)
    good = signed > 0
    assert 0 < good.sum() < 15
    extremes = dihedral_extremes(nodes, tets)
    assert np.allclose(extremes[good, 0], angles[good].min(1))
    assert np.allclose(extremes[good, 1], angles[good].max(1))
    assert (extremes[~good] == [0, 180]).all()
    assert quality(nodes, tets).inverted == (~good).sum()
    expected = np.histogram(angles[good], bins=90, range=(0, 180))[0]
    assert np.array_equal(dihedral_histogram(nodes, tets), expected)


def test_flat_cells_are_found():
    nodes = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
    found = quality(nodes, ONE)
    assert found.inverted == 1
    assert found.radius_ratio == np.inf


def test_refused():
    with pytest.raises(ValueError, match="without tetrahedra"):
        quality(CORNER, np.empty((0, 4), int))
    with pytest.raises(ValueError, match="does not exist"):
        quality(CORNER, np.array([[0, 1, 2, 4]]))
    with pytest.raises(ValueError, match="divide"):
        dihedral_histogram(CORNER, ONE, 7)
