"""Voronoi cells against Qhull's, and those of lattices."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull, HalfspaceIntersection, Voronoi

from sppm_pipeline.features.walls.numerics.cells import voronoi_cells

IMAGES = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])


def repeated(points):
    """The pores of a periodic cell with their images; those of the cell come first."""
    order = np.argsort((IMAGES**2).sum(1), kind="stable")
    return (points[None] + IMAGES[order][:, None]).reshape(-1, 3)


def planes_of(cells, k):
    return cells.planes[cells.first[k] : cells.first[k + 1]]


@pytest.mark.parametrize("seed", [1, 2])
def test_cells_have_the_neighbors_and_extents_that_qhull_finds(seed):
    points = np.random.default_rng(seed).random((40, 3))
    every = repeated(points)
    cells = voronoi_cells(every, np.arange(40), 0.8)
    reference = Voronoi(every)
    for k in range(40):
        ridges = reference.ridge_points[(reference.ridge_points == k).any(1)]
        step = every[ridges.sum(1) - k] - every[k]
        length = np.linalg.norm(step, axis=1)
        expected = np.column_stack([step / length[:, None], length / 2])
        found = planes_of(cells, k)
        assert len(found) == len(expected)
        np.testing.assert_allclose(found[np.lexsort(found.T)], expected[np.lexsort(expected.T)], atol=1e-9)
        corners = reference.vertices[reference.regions[reference.point_region[k]]]
        np.testing.assert_allclose(cells.lower[k], corners.min(0), atol=1e-9)
        np.testing.assert_allclose(cells.upper[k], corners.max(0), atol=1e-9)


@pytest.mark.parametrize(
    ("basis", "faces"),
    [
        ([[0, 0, 0]], 6),
        ([[0, 0, 0], [0.5, 0.5, 0.5]], 14),
        ([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]], 12),
    ],
    ids=["cube", "truncated octahedron", "rhombic dodecahedron"],
)
@pytest.mark.parametrize("turned", [False, True])
def test_cells_of_lattices_are_the_known_polyhedra(basis, faces, turned):
    """Where more than three planes meet, none is lost; the volume is that of a lattice point."""
    basis = np.array(basis, float)
    every = np.concatenate([basis + image for image in 2 * IMAGES] + [basis + image for image in IMAGES])
    every = np.unique(every, axis=0)
    if turned:
        every = every @ np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    cells = voronoi_cells(every, np.flatnonzero((every**2).sum(1) == 0), 0.9)
    found = planes_of(cells, 0)
    halfspaces = np.column_stack([found[:, :3], -found[:, 3]])
    corners = HalfspaceIntersection(halfspaces, np.zeros(3)).intersections
    assert ConvexHull(corners).volume == pytest.approx(1 / len(basis), rel=1e-6)
    assert faces <= len(found) <= 18
    assert len(np.unique(np.round(found[:, 3][found[:, 3] < np.sort(found[:, 3])[faces - 1] + 1e-6], 9))) <= 2


def test_pores_at_one_place_count_as_one():
    points = np.random.default_rng(4).random((12, 3))
    every = repeated(points)
    once = voronoi_cells(every, np.arange(12), 1.0)
    twice = voronoi_cells(np.concatenate([every, every]), np.arange(12), 1.0)
    for k in range(12):
        a, b = planes_of(once, k), planes_of(twice, k)
        np.testing.assert_allclose(a[np.lexsort(a.T)], b[np.lexsort(b.T)], atol=1e-12)


def test_a_cell_may_have_hundreds_of_faces():
    """A pore in the middle of a shell of others; more planes than there is room for at first."""
    rng = np.random.default_rng(5)
    shell = rng.standard_normal((400, 3))
    every = np.concatenate([np.zeros((1, 3)), shell / np.linalg.norm(shell, axis=1)[:, None]])
    cells = voronoi_cells(every, np.array([0]), 2.0)
    assert len(cells.planes) == 400
    np.testing.assert_allclose(cells.planes[:, 3], 0.5)


def test_the_outermost_cells_end_in_their_box():
    cells = voronoi_cells(np.array([[0.0, 0.0, 0.0], [0.4, 0.0, 0.0]]), np.arange(2), 1.0)
    np.testing.assert_allclose(cells.planes, [[1, 0, 0, 0.2], [-1, 0, 0, 0.2]])
    np.testing.assert_allclose(cells.lower, [[-1, -1, -1], [0.2, -1, -1]])
    np.testing.assert_allclose(cells.upper, [[0.2, 1, 1], [1.4, 1, 1]])


def test_pores_too_far_apart_have_no_face_in_common():
    cells = voronoi_cells(np.array([[0.0, 0.0, 0.0], [2.1, 0.0, 0.0]]), np.arange(2), 1.0)
    assert len(cells.planes) == 0
