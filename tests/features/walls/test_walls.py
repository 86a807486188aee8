"""Walls of any tiling against the definition over all its pores and tunnels."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sppm_pipeline.features.walls.numerics import walls
from sppm_pipeline.features.walls.numerics.walls import WallSampler, largest_empty_radius
from sppm_pipeline.method.assembly.contents import Pieces, TilingArrays
from sppm_pipeline.method.kernels.kernels import Kernels
from sppm_pipeline.services.grid import Grid

MARGIN = 0.05


def inside(tiling, where):
    """Points in cells that are there."""
    cell = np.floor(where).astype(int)
    wrapped = cell % np.array(tiling.shape) if tiling.periodic else cell
    return tiling.interior[tuple((wrapped + tiling.halo).T)] >= 0


def positions(grid):
    x, y, z = (grid.axis(a) for a in range(3))
    return np.stack(np.meshgrid(z, y, x, indexing="ij")[::-1], -1).reshape(-1, 3)


def from_all(kernels, where):
    """Distance from the faces, and depth in the tunnels."""
    points = np.unique(kernels.centers, axis=0)
    nearest = cKDTree(points).query(where)[1]
    distance, depth = np.full(len(where), np.inf), np.full(len(where), -MARGIN)
    for own in np.unique(nearest):
        at = np.flatnonzero(nearest == own)
        others = np.delete(points, own, axis=0)
        squares = ((where[at][:, None] - others) ** 2).sum(2) - ((where[at] - points[own]) ** 2).sum(1)[:, None]
        distance[at] = (squares / (2 * np.linalg.norm(others - points[own], axis=1))).min(1)
    for a, b, mu in zip(kernels.starts, kernels.ends, kernels.mu, strict=True):
        along = b - a
        share = np.clip((where - a) @ along / max(along @ along, 1e-30), 0, 1)
        depth = np.maximum(depth, 1 / mu - np.linalg.norm(where - a - share[:, None] * along, axis=1))
    return distance, depth


@pytest.mark.parametrize("periodic", [True, False])
def test_walls_are_those_of_all_pores_and_tunnels(sets, periodic):
    pieces = sets.pieces(1)
    tiling = sets.tiling(2, (3, 2, 2), pieces, periodic, holes=0.0)
    grid = Grid((0.02, 0.03, 0.01), (0.093, 0.081, 0.117), (32, 24, 17))
    distance, depth = WallSampler(pieces, tiling, 0.0, MARGIN).sample(grid, 0, 17)
    chosen = np.random.default_rng(1).choice(distance.size, 1500, replace=False)
    every = sets.every_kernel(pieces, tiling, images=1 if periodic else 0)
    expected, tunnels = from_all(every, positions(grid)[chosen])
    np.testing.assert_allclose(distance.ravel()[chosen], expected, atol=5e-7)
    np.testing.assert_allclose(depth.ravel()[chosen], tunnels, atol=5e-7)


def test_walls_of_a_tiling_with_holes_are_exact_in_its_cells(sets):
    pieces = sets.pieces(3)
    tiling = sets.tiling(4, (3, 3, 2), pieces, holes=0.3)
    grid = Grid((0.02, 0.03, 0.01), (0.093, 0.121, 0.117), (32, 24, 17))
    distance, _ = WallSampler(pieces, tiling, 0.0, MARGIN).sample(grid, 0, 17)
    where = positions(grid)
    there = inside(tiling, where)
    expected, _ = from_all(sets.every_kernel(pieces, tiling), where[there])
    found = distance.ravel()[there]
    # where a wall leads out of the cells its distance is that of the part inside: never less than the true one
    assert (found >= expected - 5e-7).all()
    thin = np.minimum(found, expected) < 0.02
    assert (np.abs(found - expected)[thin] < 5e-7).mean() > 0.995


@pytest.mark.parametrize("rounding", [0.0, 0.03])
def test_slabs_threads_and_what_is_kept_do_not_change_a_byte(sets, monkeypatch, rounding):
    pieces = sets.pieces(5)
    tiling = sets.tiling(6, (2, 2, 3), pieces, periodic=True)
    grid = Grid((-0.4, 0.03, 0.01), (0.093, 0.081, 0.067), (24, 24, 40))
    whole = WallSampler(pieces, tiling, rounding, MARGIN).sample(grid, 0, 40)
    monkeypatch.setattr(walls, "_KEPT_BYTES", 1)
    other = WallSampler(pieces, tiling, rounding, MARGIN)
    for start, stop in ((0, 1), (13, 14), (14, 15), (39, 40), (0, 7), (7, 14), (35, 40), (0, 33)):
        for part, all_ in zip(other.sample(grid, start, stop, 2), whole, strict=True):
            assert part.tobytes() == all_[start:stop].tobytes()


def test_a_halo_of_cells_is_there_and_not_in_the_box():
    """A box of one cell in a halo has the walls of the middle cell of the same 27 cells without one."""
    rng = np.random.default_rng(8)
    none = np.zeros((0, 3))
    pieces = Pieces.of([Kernels(rng.random((20, 3)), np.ones(20), none, none, np.zeros(0)) for _ in range(27)])
    numbers = np.arange(27, dtype=np.int32).reshape(3, 3, 3)
    faces = tuple(np.full(tuple(3 + (a == axis) for a in range(3)), -1, np.int32) for axis in range(3))
    with_halo = WallSampler(pieces, TilingArrays(numbers, faces, False, 1), 0.0, MARGIN)
    without = WallSampler(pieces, TilingArrays(numbers, faces, False), 0.0, MARGIN)
    grid = Grid((0.05,) * 3, (0.1,) * 3, (10, 10, 10))
    moved = Grid((1.05,) * 3, (0.1,) * 3, (10, 10, 10))
    np.testing.assert_allclose(with_halo.sample(grid, 0, 10)[0], without.sample(moved, 0, 10)[0], atol=1e-6)


def test_no_point_lies_farther_from_a_pore_than_the_bound(sets):
    pieces = sets.pieces(9, interiors=4)
    bound = largest_empty_radius(pieces)
    where = np.random.default_rng(9).random((4000, 3))
    true = max(cKDTree(pieces[t].centers).query(where)[0].max() for t in range(4))
    assert true <= bound <= true + 0.2
    none = np.zeros((0, 3))
    empty = Pieces.of([Kernels(none, np.zeros(0), none, none, np.zeros(0))])
    assert largest_empty_radius(empty) == pytest.approx(3**0.5)
