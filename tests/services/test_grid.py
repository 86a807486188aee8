"""Sample grids: where their points lie, and samples of one period."""

import itertools

import numpy as np
import pytest

from sppm_pipeline.services.grid import (
    VOXEL_FACES,
    Grid,
    cell_centers,
    cell_nodes,
    covering_voxels,
    sample_one_period,
)

GRID = Grid((0.5, -1.0, 2.0), (0.1, 0.2, 0.4), (3, 4, 5))


def points(grid):
    """All points of a grid, sorted, by the definition in its docstring."""
    found = [tuple(np.add(grid.origin, np.multiply(ijk, grid.spacing))) for ijk in np.ndindex(*grid.shape)]
    return np.array(sorted(found))


def test_axes_and_layers():
    assert [GRID.axis(axis)[[0, 1, -1]].tolist() for axis in range(3)] == [
        pytest.approx([0.5, 0.6, 0.7]), pytest.approx([-1.0, -0.8, -0.4]), pytest.approx([2.0, 2.4, 3.6]),
    ]  # fmt: skip
    part = GRID.layers(1, 3)
    assert part.shape == (3, 4, 2)
    assert part.axis(2) == pytest.approx(GRID.axis(2)[1:3])
    assert part[0][:2] == GRID[0][:2]


@pytest.mark.parametrize("m", [1, 2, 4])
def test_subsamples_are_the_middles_of_the_parts_of_a_pixel(m):
    assert GRID.subsampled(1) is GRID
    offsets = [
        (-1 / 3 + i / 3, -1 / 3 + j / 3, (k + 0.5) / m - 0.5)
        for i, j, k in itertools.product(range(3), range(3), range(m))
    ]
    expected = np.concatenate([points(GRID) + np.multiply(offset, GRID.spacing) for offset in offsets])
    found = points(GRID.subsampled(3, m))
    assert found == pytest.approx(expected[np.lexsort(np.round(expected, 9).T[::-1])])


def test_voxels_that_cover_a_box():
    assert covering_voxels((0.05, -0.35, 1.0), (0.31, -0.05, 1.0), (0.1, 0.1, 0.5)) == ((0, -4, 2), (4, 4, 1))
    assert covering_voxels((0.1, 0.2, 0.3), (0.3, 0.4, 0.6), 0.1) == ((1, 2, 3), (2, 2, 3))  # rounding is no part
    assert covering_voxels((0.1 - 1e-5,) * 3, (0.2 + 1e-5,) * 3, 0.1) == ((0, 0, 0), (3, 3, 3))


def test_centers_and_nodes_of_cells():
    centers, nodes = cell_centers(4, (1, 2, 3)), cell_nodes(4, (1, 2, 3))
    assert centers.shape == (4, 8, 12)
    assert nodes.shape == (5, 9, 13)
    for axis, size in enumerate((1, 2, 3)):
        assert nodes.axis(axis)[[0, -1]].tolist() == [0, size]
        assert centers.axis(axis) == pytest.approx((nodes.axis(axis)[1:] + nodes.axis(axis)[:-1]) / 2)


@pytest.mark.parametrize("shape", [(4, 6, 5), (9, 6, 5), (4, 13, 5), (3, 2, 12), (9, 13, 17), (2, 7, 11)])
@pytest.mark.parametrize("period", [(1, 2, 1), (1, 1, 1)])
def test_every_point_of_a_period_is_computed_once(shape, period):
    """Compared with samples of all points; along z any range of layers may be asked for."""
    grid = Grid((0.1, 0.2, 0.05), (0.25, 1 / 3, 0.2), shape)

    def sample(part, start, stop):
        computed.append(part.shape[0] * part.shape[1] * (stop - start))
        x, y, z = (part.axis(axis) for axis in range(3))
        z = z[start:stop, None, None]
        return np.cos(2 * np.pi * x / period[0]) + np.sin(2 * np.pi * y[:, None] / period[1]) + np.cos(2 * np.pi * z)

    counts = [min(n, round(p / h)) for n, p, h in zip(shape, period, grid.spacing, strict=True)]
    parts = ((0, shape[2]), (0, 2), (1, 5), (3, shape[2]), (2, 2), (3, 7), (max(0, shape[2] - 7), shape[2] - 1))
    for start, stop in (part for part in parts if part[1] <= shape[2]):
        computed: list[int] = []
        found = sample_one_period(grid, period, start, stop, sample)
        asked = sum(computed)
        assert asked <= counts[0] * counts[1] * min(max(stop - start, 0), counts[2])
        assert found.shape == (stop - start, shape[1], shape[0])
        assert np.allclose(found, sample(grid, start, stop), atol=1e-12)


def test_nothing_is_shared_where_the_period_is_no_number_of_samples():
    grid = Grid((0.0,) * 3, (0.3, 0.3, 0.3), (8, 8, 8))
    shapes = []

    def sample(part, start, stop):
        shapes.append((part.shape, start, stop))
        return np.zeros((stop - start, part.shape[1], part.shape[0]))

    assert sample_one_period(grid, (1, 1, 1), 2, 7, sample).shape == (5, 8, 8)
    assert shapes == [((8, 8, 8), 2, 7)]


def test_faces_of_a_voxel_are_seen_from_their_neighbors():
    for neighbor, corners in VOXEL_FACES:
        at = np.array([[corner & 1, corner >> 1 & 1, corner >> 2] for corner in corners])
        assert (at.mean(axis=0) - 0.5).tolist() == [step / 2 for step in neighbor]
        assert np.cross(at[1] - at[0], at[2] - at[1]).tolist() == list(neighbor)
    assert len({neighbor for neighbor, _ in VOXEL_FACES}) == 6
