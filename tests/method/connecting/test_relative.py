"""The relative neighborhood graph against its definition and the spanning tree that it contains."""

import itertools

import numpy as np
import pytest
from scipy.sparse.csgraph import minimum_spanning_tree as scipy_tree
from scipy.spatial.distance import cdist

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting import relative
from sppm_pipeline.method.connecting.relative import relative_neighbors
from sppm_pipeline.method.connecting.relative_degrees import relative_neighbor_graph, shortest_tree
from sppm_pipeline.method.connecting.trees import component_labels, edge_lengths, minimum_spanning_tree

BOX = np.zeros(3)
PERIODS = [(0, 0, 0), (1, 1, 1), (2, 0, 1), (0, 3, 0)]


def by_definition(points, period):
    """Every pair of pores and images, against every pore and image."""
    images = np.array(list(itertools.product(*[(-2, -1, 0, 1, 2) if p else (0,) for p in period])))
    everywhere = (points + (images * period)[:, None]).reshape(-1, 3)
    edges = set()
    for i, point in enumerate(points):
        to = ((everywhere - point) ** 2).sum(1)
        beyond = (np.abs(everywhere - point) > period)[:, np.asarray(period) > 0].any(1)
        order = np.argsort(to)
        for c in np.flatnonzero(~beyond):
            image, j = divmod(int(c), len(points))
            nearer = order[: np.searchsorted(to[order], to[c])]
            # the nearest first, as they decide about nearly all
            if j > i and not any(
                (((everywhere[some] - everywhere[c]) ** 2).sum(1) < to[c]).any() for some in (nearer[:20], nearer)
            ):
                edges.add((i, j, *images[image].tolist()))
    return edges


def as_rows(edges, turns):
    rows = np.hstack([edges, turns]).astype(int).tolist()
    assert len(set(map(tuple, rows))) == len(rows)
    return set(map(tuple, rows))


@pytest.mark.parametrize("period", PERIODS)
@pytest.mark.parametrize("n", [2, 3, 12, 36])
def test_the_definition(period, n):
    period = np.array(period, float)
    for seed in range(3):
        points = np.random.default_rng(seed).random((n, 3)) * np.where(period > 0, period, 1)
        assert as_rows(*relative_neighbors(points, period)) == by_definition(points, period)


@pytest.mark.parametrize("period", PERIODS)
def test_ties_of_a_lattice_keep_all_edges_between_neighbors(period):
    period = np.array(period, float)
    size = np.where(period > 0, period, 1)
    points = np.unique(np.floor(np.random.default_rng(1).random((80, 3)) * size * 4) / 4, axis=0)
    edges, turns = relative_neighbors(points, period)
    assert as_rows(edges, turns) == by_definition(points, period)
    assert component_labels(len(points), edges).max() == 0


def test_clusters_planes_and_doubled_pores():
    rng = np.random.default_rng(2)
    cluster = np.concatenate([rng.random((80, 3)) * 1e-3, rng.random((20, 3))])
    plane = rng.random((60, 3)) * [1, 1, 0]
    doubled = np.repeat(rng.random((20, 3)), 3, axis=0)
    for points in (cluster, plane, doubled, np.repeat(rng.random((1, 3)), 90, axis=0)):
        assert as_rows(*relative_neighbors(points, BOX)) == by_definition(points, BOX)


@pytest.mark.parametrize("period", [(1, 1, 1), (0, 1, 0), (2, 0, 1)])
def test_a_cluster_far_from_its_images_ends_its_search(period):
    points = 0.4 + np.random.default_rng(9).random((40, 3)) * 1e-3
    points[0] = 0.9
    assert as_rows(*relative_neighbors(points, np.array(period, float))) == by_definition(points, period)


@pytest.mark.parametrize("count", [1, 3, 4])
def test_each_direction_lies_within_the_widest_angle_of_a_facet(count):
    centers, widest = relative._facets(count)
    assert centers.shape == (6 * count**2, 3)
    directions = np.random.default_rng(10).standard_normal((20_000, 3))
    cosines = (directions @ centers.T).max(1) / np.linalg.norm(directions, axis=1)
    assert np.cos(widest) <= cosines.min() < np.cos(0.85 * widest)


def test_threads_and_the_size_of_chunks_change_nothing(monkeypatch):
    points = np.random.default_rng(3).random((3000, 3))
    whole = relative_neighbors(points, np.ones(3))
    monkeypatch.setattr(relative, "_CHUNK", 100)
    for threads in (1, 3):
        for mine, other in zip(whole, relative_neighbors(points, np.ones(3), threads=threads), strict=True):
            assert np.array_equal(mine, other)


def test_it_contains_the_spanning_tree():
    for seed in range(4):
        points = np.random.default_rng(seed).random((400, 3))
        distances = cdist(points, points)
        tree = set(zip(*map(np.ndarray.tolist, scipy_tree(distances).nonzero()), strict=True))
        edges, _ = relative_neighbors(points, BOX)
        assert {tuple(sorted(e)) for e in tree} <= set(map(tuple, edges.tolist()))


@pytest.mark.parametrize("period", PERIODS)
def test_kruskal_on_it_finds_the_tree_of_all_pairs(period):
    period = np.array(period, float)
    points = np.random.default_rng(5).random((800, 3)) * np.where(period > 0, period, 1) - 3.0
    for mine, other in zip(
        shortest_tree(points, period), minimum_spanning_tree(points, periodic=period.tolist()), strict=True
    ):
        assert np.array_equal(mine, other)


def test_beyond_its_reach_it_still_contains_the_tree():
    rng = np.random.default_rng(6)
    points = rng.random((240, 3)) + np.repeat(np.arange(4.0) * 5, 60)[:, None] * [1, 0, 0]
    tree, _ = minimum_spanning_tree(points)
    edges, _, _ = relative_neighbor_graph(points, BOX, (1, 64), reach=1.0)
    assert set(map(tuple, tree.tolist())) <= set(map(tuple, edges.tolist()))
    assert (edge_lengths(points, edges, np.zeros((len(edges), 3))) > 1).sum() == 3


@pytest.mark.parametrize("period", [(0, 0, 0), (1, 1, 1), (0, 2, 1)])
@pytest.mark.parametrize("degree", [(1, 4), (2, 3), (3, 5), (5, 8)])
def test_degrees_are_brought_into_bounds(period, degree):
    period = np.array(period, float)
    points = np.random.default_rng(7).random((700, 3)) * np.where(period > 0, period, 1)
    edges, shifts, over = relative_neighbor_graph(points, period, degree)
    found = np.bincount(edges.ravel(), minlength=700)
    assert found.min() >= degree[0]
    assert (found > degree[1]).sum() == over <= 7
    assert component_labels(700, edges).max() == 0
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(np.hstack([edges, shifts]), axis=0)) == len(edges)
    assert not shifts[:, period == 0].any()


def test_a_star_stays_over_its_degree_and_is_counted():
    # six pores on the axes around one: no two of them are nearer to each other than to the middle
    around = np.concatenate([np.eye(3), -np.eye(3)])
    edges, _, over = relative_neighbor_graph(np.concatenate([np.zeros((1, 3)), around]), BOX, (1, 5))
    assert over == 1
    assert edges.tolist() == [[0, j] for j in range(1, 7)]


def test_bounds_that_leave_no_room_are_refused():
    points = np.random.default_rng(8).random((301, 3))
    with pytest.raises(DesignError, match="find fewer than 3 tunnels"):
        relative_neighbor_graph(points, BOX, (3, 3))
