"""Distances from faces against the definition, and soft minima against circles."""

import numpy as np
import pytest
from scipy.spatial import Voronoi, cKDTree

from sppm_pipeline.features.walls.numerics.cells import voronoi_cells
from sppm_pipeline.features.walls.numerics.distance import UNCLAIMED, raise_to_distance
from sppm_pipeline.services.grid import Grid

GRID = Grid((-0.03, 0.11, 0.05), (0.031, 0.043, 0.057), (33, 21, 17))


def pores(seed, n=60):
    rng = np.random.default_rng(seed)
    images = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    return (rng.random((n, 3))[None] + images[:, None]).reshape(-1, 3)


def sampled(points, grid=GRID, rounding=0.0, threads=1, first=0, layers=None):
    cells = voronoi_cells(points, np.flatnonzero(((points > -0.6) & (points < 1.7)).all(1)), 0.6)
    nx, ny, nz = grid.shape
    out = np.full((nz if layers is None else layers, ny, nx), UNCLAIMED, np.float32)
    raise_to_distance(out, grid, cells, rounding, threads, first)
    return out


def positions(grid):
    x, y, z = (grid.axis(a) for a in range(3))
    return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1).reshape(-1, 3)


def from_faces(points, where, neighbors=None):
    """(d_j^2 - d_1^2) / (2 |p_j - p_1|) for all j, or for some."""
    nearest = cKDTree(points).query(where)[1]
    apart = np.linalg.norm(points[nearest][:, None] - points[None], axis=2)
    apart[apart == 0] = np.inf
    squares = ((where[:, None] - points[None]) ** 2).sum(2)
    found = (squares - squares[np.arange(len(where)), nearest][:, None]) / (2 * apart)
    found[np.arange(len(where)), nearest] = np.inf
    return found if neighbors is None else np.where(neighbors[nearest], found, np.inf)


def soft_minimum(values, radius):
    """The m with ``sum of max(m + radius - v_j, 0)^2 = radius^2`` along the last axis; the minimum for no radius."""
    least = values.min(-1)
    if radius <= 0:
        return least
    s = np.zeros_like(least)
    for _ in range(50):
        rest = np.maximum(radius - (values - least[..., None]) - s[..., None], 0)
        s += ((rest**2).sum(-1) - radius**2) / (2 * rest.sum(-1))
    return least - s


@pytest.mark.parametrize("seed", [1, 2])
def test_the_distance_is_that_of_the_definition(seed):
    points = pores(seed)
    chosen = np.random.default_rng(seed).choice(33 * 21 * 17, 1500, replace=False)
    expected = from_faces(points, positions(GRID)[chosen]).min(1)
    np.testing.assert_allclose(sampled(points).ravel()[chosen], expected, atol=2e-7)


def test_soft_distances_are_soft_minima_over_the_faces():
    points = pores(3)
    neighbors = np.zeros((len(points), len(points)), bool)
    a, b = Voronoi(points).ridge_points.T
    neighbors[a, b] = neighbors[b, a] = True
    chosen = np.random.default_rng(3).choice(33 * 21 * 17, 800, replace=False)
    expected = soft_minimum(from_faces(points, positions(GRID)[chosen], neighbors), 0.05)
    found = sampled(points, rounding=0.05).ravel()[chosen]
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert (found <= sampled(points).ravel()[chosen] + 1e-7).all()


def test_layers_and_threads_do_not_change_a_byte():
    points = pores(4)
    for rounding in (0.0, 0.04):
        whole = sampled(points, rounding=rounding)
        assert sampled(points, rounding=rounding, threads=3).tobytes() == whole.tobytes()
        for first, layers in ((0, 1), (3, 5), (16, 1)):
            part = sampled(points, rounding=rounding, first=first, layers=layers)
            assert part.tobytes() == whole[first : first + layers].tobytes()


def test_every_sample_of_a_lattice_is_claimed():
    """Samples on faces, edges and corners of cubes: each belongs to a cell, and the distance is zero there."""
    line = np.arange(-2, 4) / 2
    points = np.stack(np.meshgrid(line, line, line), -1).reshape(-1, 3)
    out = sampled(points, Grid((0.0, 0.0, 0.0), (0.125,) * 3, (9, 9, 9)))
    x = np.arange(9) / 8
    to_face = 0.25 - np.abs((x + 0.25) % 0.5 - 0.25)
    expected = np.minimum.reduce(np.meshgrid(to_face, to_face, to_face, indexing="ij"))
    np.testing.assert_allclose(out, expected, atol=1e-7)


def test_orthogonal_walls_get_circular_fillets():
    """Each level set of the soft minimum of x and y is an offset of the walls with an arc of the given radius."""
    angle = np.linspace(0, np.pi / 2, 50)
    for level in (-0.3, 0.0, 0.4):
        arc = np.column_stack([level + 0.2 - 0.2 * np.sin(angle), level + 0.2 - 0.2 * np.cos(angle)])
        np.testing.assert_allclose(soft_minimum(arc, 0.2), level, atol=1e-9)


def test_the_soft_minimum_has_the_properties_of_one():
    rng = np.random.default_rng(6)
    values = rng.random((300, 5))
    soft = soft_minimum(values, 0.2)
    least = np.sort(values, axis=1)
    np.testing.assert_allclose(soft_minimum(values + 3, 0.2), soft + 3)
    np.testing.assert_allclose(soft_minimum(values[:, ::-1], 0.2), soft)
    assert (soft <= least[:, 0] + 1e-12).all()
    assert (soft >= least[:, 0] - 0.2 * (1 - 5**-0.5) - 1e-12).all()
    alone = least[:, 1] > least[:, 0] + 0.2
    assert alone.any()
    np.testing.assert_allclose(soft[alone], least[alone, 0])
    np.testing.assert_array_equal(soft_minimum(values, 0.0), least[:, 0])
