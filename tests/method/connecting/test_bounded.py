from __future__ import annotations

import itertools

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.connecting.clearance import close_pairs
from sppm_pipeline.method.connecting.greedy import clamped_degrees, feasible_degrees, harary_edges
from sppm_pipeline.method.connecting.trees import canonical_edges, edge_lengths, images_per_pair
from sppm_pipeline.services.metric import stretched_metric

MODES = ("exact", "greedy")


def spaced_points(n: int, seed: int, share: float = 0.6) -> np.ndarray:
    """Random points with a spacing of `share` times the cube root of the volume of each."""
    rng = np.random.default_rng(seed)
    points: list[np.ndarray] = []
    while len(points) < n:
        p = rng.random(3)
        if all(((p - q) ** 2).sum() > (share / n ** (1 / 3)) ** 2 for q in points):
            points.append(p)
    return np.array(points)


def check(points, edges, shifts, degree, *, periodic=False, loops=False) -> None:
    n = len(points)
    again = canonical_edges(edges, shifts)
    assert np.array_equal(again[0], edges)
    assert np.array_equal(again[1], shifts)
    assert edges.dtype == shifts.dtype == np.int64
    assert (edges[:, 0] < edges[:, 1]).all()
    assert not shifts[:, ~np.broadcast_to(periodic, 3)].any()
    degrees = np.bincount(edges.ravel(), minlength=n)
    assert degrees.min() >= degree[0]
    assert degrees.max() <= degree[1]
    graph = networkx.MultiGraph()
    graph.add_nodes_from(range(n))
    graph.add_edges_from(edges.tolist())
    assert networkx.is_connected(graph)
    if loops:
        assert not list(networkx.bridges(graph))


def feasible(n: int, lower: int, upper: int, images: int = 1, loops: bool = False) -> bool:
    """The rule, spelt out once more without the code under test."""
    if n == 1:
        return lower == 0
    if loops:
        lower = max(lower, 2)
    if lower > images * (n - 1) or lower > upper or (lower == upper and n * lower % 2):
        return False
    return upper >= (2 if n > 2 else 1)


BOUNDS = [(a, b) for a in range(7) for b in range(a, 7)]


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n", range(1, 13))
def test_every_feasible_range_is_met_and_every_other_refused(n, mode):
    points = np.random.default_rng(n).random((n, 3))
    # the integer programs are slow to start; the greedy search sees every case with loops as well
    for (lower, upper), loops in itertools.product(BOUNDS, (False, True) if mode == "greedy" else (n % 2 == 0,)):
        arguments = {"mode": mode, "two_edge_connected": loops}
        if feasible(n, lower, upper, loops=loops):
            check(points, *spanning_subgraph(points, (lower, upper), **arguments), (lower, upper), loops=loops)
        else:
            with pytest.raises(DesignError):
                spanning_subgraph(points, (lower, upper), **arguments)


@pytest.mark.parametrize("periodic", [(True, True, True), (True, True, False), (False, True, False)])
@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 7])
def test_periodic_cells_with_few_pores(n, periodic):
    points = np.random.default_rng(n).random((n, 3))
    images = images_per_pair(periodic)
    for (lower, upper), loops in itertools.product(BOUNDS, (False, True)):
        arguments = {"periodic": periodic, "two_edge_connected": loops}
        if feasible(n, lower, upper, images, loops):
            for mode in ("greedy", "exact") if upper == lower + 2 else ("greedy",):
                graph = spanning_subgraph(points, (lower, upper), mode=mode, **arguments)
                check(points, *graph, (lower, upper), periodic=periodic, loops=loops)
        else:
            with pytest.raises(DesignError):
                spanning_subgraph(points, (lower, upper), mode="greedy", **arguments)


def shortest_by_enumeration(points, degree, loops) -> float:
    n = len(points)
    edges = np.array(list(itertools.combinations(range(n), 2)))
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    best = np.inf
    for bits in range(1 << len(edges)):
        picked = np.array([bits >> e & 1 for e in range(len(edges))], dtype=bool)
        cost = lengths[picked].sum()
        degrees = np.bincount(edges[picked].ravel(), minlength=n)
        if cost >= best or degrees.min() < degree[0] or degrees.max() > degree[1]:
            continue
        graph = networkx.Graph(edges[picked].tolist())
        if len(graph) == n and networkx.is_connected(graph) and not (loops and list(networkx.bridges(graph))):
            best = cost
    return best


@pytest.mark.parametrize(
    ("n", "degree"),
    [
        (n, degree)
        for n in (4, 5, 6)
        for degree in ((1, 2), (1, 5), (2, 3), (3, 3), (3, 5))
        if (n, degree) != (5, (3, 3))
    ],
)
def test_exact_is_the_shortest_of_all_graphs(n, degree):
    loops = n % 2 == 1
    points = np.random.default_rng(10 * n).random((n, 3))
    edges, shifts = spanning_subgraph(points, degree, two_edge_connected=loops)
    assert edge_lengths(points, edges, shifts).sum() == pytest.approx(shortest_by_enumeration(points, degree, loops))


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize(("degree", "percent"), [((3, 5), 4.0), ((4, 6), 4.0), ((1, 3), 1.0)])
def test_modes_are_ordered_and_near_each_other(periodic, degree, percent):
    points = spaced_points(150, 1)
    cost = {}
    for mode in MODES:
        graph = spanning_subgraph(points, degree, mode=mode, periodic=periodic)
        check(points, *graph, degree, periodic=periodic)
        cost[mode] = edge_lengths(points, *graph).sum()
    assert cost["exact"] <= cost["greedy"] * (1 + 1e-9)
    assert cost["greedy"] <= cost["exact"] * (1 + percent / 100)


@pytest.mark.parametrize("mode", MODES)
def test_loops_cost_little_and_leave_no_bridge(mode):
    points = spaced_points(150, 2)
    plain = spanning_subgraph(points, (3, 5), mode=mode)
    loops = spanning_subgraph(points, (3, 5), mode=mode, two_edge_connected=True)
    check(points, *loops, (3, 5), loops=True)
    assert edge_lengths(points, *loops).sum() <= 1.01 * edge_lengths(points, *plain).sum()


def test_loops_are_made_where_the_shortest_graph_has_a_bridge():
    # two tight clusters far apart: one tunnel between them is shortest, two are asked for
    rng = np.random.default_rng(3)
    points = np.concatenate([0.1 * rng.random((8, 3)), 0.1 * rng.random((8, 3)) + [0.9, 0, 0]])
    for mode in MODES:
        edges, shifts = spanning_subgraph(points, (3, 5), mode=mode)
        assert ((edges < 8).sum(axis=1) == 1).sum() == 1
        edges, shifts = spanning_subgraph(points, (3, 5), mode=mode, two_edge_connected=True)
        check(points, edges, shifts, (3, 5), loops=True)
        assert ((edges < 8).sum(axis=1) == 1).sum() == 2


def test_clusters_beyond_the_nearest_neighbors_are_joined():
    rng = np.random.default_rng(4)
    points = np.concatenate([0.05 * rng.random((40, 3)) + corner for corner in ([0, 0, 0], [0.9, 0, 0], [0, 0.9, 0.9])])
    for mode in MODES:
        check(points, *spanning_subgraph(points, (3, 5), mode=mode, k=4), (3, 5))


def test_hamiltonian_path_needs_more_than_near_neighbors():
    points = spaced_points(60, 5)
    for degree in ((1, 2), (2, 2)):
        check(points, *spanning_subgraph(points, degree, mode="greedy", k=3), degree)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("periodic", [False, True])
def test_clearance_is_held(mode, periodic):
    # loosely spaced pores: among well spaced ones the short tunnels hardly ever come close
    points = spaced_points(60, 6, 0.3)
    free = spanning_subgraph(points, (3, 5), mode=mode, periodic=periodic)
    clearance = 0.05
    # the case must bite: without the option some tunnels are too close
    assert len(close_pairs(points, *free, clearance, periodic=periodic)[0])
    graph = spanning_subgraph(points, (3, 5), mode=mode, periodic=periodic, clearance=clearance)
    check(points, *graph, (3, 5), periodic=periodic)
    assert not len(close_pairs(points, *graph, clearance, periodic=periodic)[0])
    assert edge_lengths(points, *graph).sum() >= edge_lengths(points, *free).sum() * (0.98 if mode == "greedy" else 1)


@pytest.mark.parametrize("mode", MODES)
def test_impossible_clearance_names_what_was_met(mode):
    with pytest.raises(DesignError, match=r"\d+ pairs that come closer and meets a clearance of 0\.\d+"):
        spanning_subgraph(spaced_points(12, 7), (3, 5), mode=mode, clearance=0.6)


@pytest.mark.parametrize("mode", MODES)
def test_same_input_same_graph_and_whole_cells_do_not_matter(mode):
    points = spaced_points(40, 8)
    edges, shifts = spanning_subgraph(points, (3, 5), mode=mode, periodic=True)
    again = spanning_subgraph(points.copy(), (3, 5), mode=mode, periodic=True)
    assert np.array_equal(edges, again[0])
    assert np.array_equal(shifts, again[1])
    moved = points + np.random.default_rng(0).integers(-2, 3, points.shape)
    graph = spanning_subgraph(moved, (3, 5), mode=mode, periodic=True)
    assert edge_lengths(moved, *graph).sum() == pytest.approx(edge_lengths(points, edges, shifts).sum(), rel=1e-9)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    n=st.integers(2, 40),
    seed=st.integers(0, 1000),
    lower=st.integers(0, 5),
    more=st.integers(0, 3),
    periodic=st.booleans(),
    loops=st.booleans(),
    flat=st.booleans(),
    k=st.integers(1, 10),
)
def test_greedy_always_delivers(n, seed, lower, more, periodic, loops, flat, k):
    points = np.random.default_rng(seed).random((n, 3))
    if flat:
        # a grid of equal distances: every comparison is a tie
        points = np.floor(points * 4) / 4
        points[:, 0] = 0
    degree = (lower, lower + more)
    images = images_per_pair(periodic)
    arguments = {"mode": "greedy", "periodic": periodic, "two_edge_connected": loops, "k": k}
    if feasible(n, *degree, images, loops):
        check(points, *spanning_subgraph(points, degree, **arguments), degree, periodic=periodic, loops=loops)
    else:
        with pytest.raises(DesignError):
            spanning_subgraph(points, degree, **arguments)


def test_refusals_name_the_number_and_the_way_out():
    with pytest.raises(DesignError, match=r"3 pores can't have 3 tunnels each: a pore has at most 2") as caught:
        feasible_degrees(3, 3, 5)
    assert "at least 4 pores" in str(caught.value)
    with pytest.raises(DesignError, match=r"5 pores can't have exactly 3 tunnels"):
        feasible_degrees(5, 3, 3)
    with pytest.raises(DesignError, match=r"no loop"):
        feasible_degrees(2, 1, 3, two_edge_connected=True)
    with pytest.raises(DesignError, match="not a range"):
        feasible_degrees(5, 4, 3)
    with pytest.raises(DesignError, match="clearance"):
        spanning_subgraph(np.zeros((3, 3)), (1, 2), clearance=-0.1)


@pytest.mark.parametrize("images", [1, 4])
@pytest.mark.parametrize("n", range(1, 8))
def test_clamped_degrees_are_feasible_and_nearest(n, images):
    for lower, upper in [(3, 5), (3, 3), (4, 4), (0, 2), (6, 6)]:
        low, high, relaxed = clamped_degrees(n, lower, upper, images=images)
        feasible_degrees(n, low, high, images=images)
        assert relaxed == ((low, high) != (lower, upper))
        assert low <= lower
        assert upper <= high <= upper + 1
        if feasible(n, lower, upper, images):
            assert not relaxed


def test_clamped_face_of_four_is_complete_and_of_three_a_triangle():
    assert clamped_degrees(4, 3, 5) == (3, 5, False)
    assert clamped_degrees(3, 3, 5) == (2, 5, True)
    points = np.random.default_rng(0).random((4, 3))
    assert len(spanning_subgraph(points, (3, 5))[0]) == 6


@pytest.mark.parametrize("n", range(2, 10))
def test_ring_graphs_have_their_degree_and_connectivity(n):
    for degree in range(1, 2 * n):
        pairs = harary_edges(n, degree)
        degrees = np.sort(np.bincount(pairs.ravel(), minlength=n))
        assert (degrees[:-1] == degree).all()
        assert degrees[-1] == degree + n * degree % 2
        if 2 <= degree < n:
            assert networkx.edge_connectivity(networkx.Graph(pairs.tolist())) == degree
        if degree < n:
            assert len({tuple(pair) for pair in pairs.tolist()}) == len(pairs)


@pytest.mark.parametrize("mode", ["exact", "greedy"])
def test_stretched_pores_are_joined_as_the_plain_ones_they_stand_for(mode):
    plain = np.random.default_rng(3).random((40, 3))
    direction = np.array([1.0, 2, 2]) / 3
    stretching = np.eye(3) + 0.9 * np.outer(direction, direction)
    metric = stretched_metric(np.full(40, 1.9), np.tile(direction, (40, 1)))
    wanted, _ = spanning_subgraph(plain, (3, 5), mode=mode)
    found, _ = spanning_subgraph(plain @ stretching, (3, 5), mode=mode, metric=metric)
    others, _ = spanning_subgraph(plain @ stretching, (3, 5), mode=mode)
    assert np.array_equal(found, wanted)
    assert not np.array_equal(others, wanted)


def test_regions_of_stretched_pores_are_nearly_as_short_as_those_of_plain_ones(monkeypatch):
    from sppm_pipeline.method.connecting import regional

    monkeypatch.setattr(regional, "GREEDY_REGION", 150)
    plain = np.random.default_rng(3).random((600, 3)) * 600 ** (1 / 3)
    metric = stretched_metric(np.full(600, 0.5), np.tile([0.0, 0, 1], (600, 1)))
    options = {"spacing": 1.0, "mode": "greedy", "k": 10}
    lengths = []
    for points, measured in ((plain, None), (plain * (1, 1, 0.5), metric)):
        edges, shifts = regional.regional_subgraph(points, np.zeros(3), (3, 5), metric=measured, **options)
        degree = np.bincount(edges.ravel())
        assert (degree.min(), degree.max() <= 5) == (3, True)
        lengths.append(edge_lengths(points, edges, shifts, measured).sum())
    assert lengths[1] == pytest.approx(lengths[0], rel=0.02)


def test_neighbors_in_a_metric_are_found_across_the_border():
    from sppm_pipeline.method.connecting.candidates import candidate_graph
    from sppm_pipeline.services.metric import matrices

    rng = np.random.default_rng(5)
    points, metric = rng.random((60, 3)), stretched_metric(np.full(60, 1.7), np.tile([0.3, 1.0, 0.5], (60, 1)))
    edges, shifts = candidate_graph(points, 4, periodic=True, metric=metric)
    found = {(i, j, *s) for (i, j), s in zip(edges.tolist(), shifts.tolist(), strict=True)}
    turns = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    missed = 0
    for i in range(60):
        steps = points[:, None] + turns - points[i]
        lengths = np.einsum("ijk,kl,ijl->ij", steps, matrices(metric[:1])[0], steps)
        lengths[i] = np.inf
        for nearest in np.argsort(lengths, axis=None)[:4]:
            j, turn = divmod(int(nearest), 27)
            key = (i, j, *turns[turn].tolist()) if i < j else (j, i, *(-turns[turn]).tolist())
            missed += key not in found
    # candidates are as many of the plainly nearest as the mean density asks for
    assert missed <= 5
    assert sum(any(s) for s in shifts.tolist()) > 20
