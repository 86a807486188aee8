"""Neighbors, boundaries and components against the obvious way."""

from collections import Counter

import numpy as np
import pytest
from scipy.spatial import Delaunay
from sppm_tetrahedra.numerics.faces import BOUNDARY, NON_MANIFOLD, boundary_triangles, components, face_neighbors

from sppm_pipeline.services.mesh.measures import measure_surface


def triangulated(count, seed):
    """A Delaunay triangulation of random points, positively oriented; as many around its first point as it gets."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3))
    tets = Delaunay(points).simplices
    a, b, c, d = (points[tets[:, i]] for i in range(4))
    inverted = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[inverted] = tets[inverted][:, [0, 1, 3, 2]]
    return points, tets


def test_neighbors_share_faces():
    _, tets = triangulated(200, 0)
    neighbors = face_neighbors(tets)
    count = Counter(frozenset(np.delete(tet, i).tolist()) for tet in tets for i in range(4))
    for tet, row in zip(tets, neighbors, strict=True):
        for i, other in enumerate(row):
            face = frozenset(np.delete(tet, i).tolist())
            assert (other == BOUNDARY) == (count[face] == 1)
            if other != BOUNDARY:
                assert face < set(tets[other].tolist())


def test_a_node_with_very_many_cells():
    rng = np.random.default_rng(1)
    sphere = rng.normal(size=(400, 3))
    points = np.concatenate([[[0.0, 0, 0]], sphere / np.linalg.norm(sphere, axis=1)[:, None]])
    tets = Delaunay(points).simplices
    neighbors = face_neighbors(np.sort(tets, axis=1))
    assert (neighbors >= 0).sum() + (neighbors == BOUNDARY).sum() == 4 * len(tets)
    assert (neighbors == BOUNDARY).sum() == 2 * 400 - 4


def test_the_boundary_is_closed_and_points_outward():
    points, tets = triangulated(300, 2)
    surface = boundary_triangles(tets, face_neighbors(tets))
    found = measure_surface(points, surface)
    assert found.edges.closed
    assert found.genus == 0
    total = np.abs(np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]])).sum() / 6
    assert found.volume == pytest.approx(total)


def test_non_manifold_faces():
    tets = np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 2, 5]])
    neighbors = face_neighbors(tets)
    assert (neighbors == NON_MANIFOLD).sum() == 3
    assert components(neighbors)[0] == 3


def test_components_are_numbered_by_their_first_cells():
    _, tets = triangulated(50, 3)
    both = np.concatenate([tets, tets + 50])[::-1]
    count, labels = components(face_neighbors(both))
    assert count == 2
    assert labels[0] == 0
    assert labels[-1] == 1


def test_no_cells():
    assert face_neighbors(np.empty((0, 4), np.int32)).shape == (0, 4)
    assert components(np.empty((0, 4), np.int32))[0] == 0
