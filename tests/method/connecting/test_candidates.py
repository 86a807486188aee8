from __future__ import annotations

import itertools

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.connecting.candidates import candidate_graph
from sppm_pipeline.method.connecting.trees import canonical_edges


def nearest_by_enumeration(points, k, periodic):
    """Every image of every other pore, sorted by (distance, index, shift)."""
    rows = set()
    reach = [range(-1, 2) if axis else (0,) for axis in periodic]
    for i, p in enumerate(points):
        found = []
        for j, q in enumerate(points):
            for shift in itertools.product(*reach):
                step = q + shift - p
                if j != i and all(abs(step[a]) <= 1 for a in range(3) if periodic[a]):
                    found.append(((step**2).sum(), j, shift))
        for _, j, shift in sorted(found)[:k]:
            rows.add((i, j, *shift) if i < j else (j, i, *(-s for s in shift)))
    return sorted(rows)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    n=st.integers(2, 30),
    k=st.integers(1, 14),
    seed=st.integers(0, 100),
    periodic=st.tuples(st.booleans(), st.booleans(), st.booleans()),
)
def test_holds_the_nearest_images_of_each_pore(n, k, seed, periodic):
    points = np.random.default_rng(seed).random((n, 3))
    edges, shifts = candidate_graph(points, k, periodic=periodic)
    rows = {tuple(row) for row in np.concatenate([edges, shifts], axis=1).tolist()}
    wanted = nearest_by_enumeration(points, k, periodic)
    assert rows >= set(wanted)
    graph = networkx.Graph([row[:2] for row in wanted])
    if len(graph) == n and networkx.is_connected(graph):
        assert sorted(rows) == wanted
    graph.add_edges_from(edges.tolist())
    assert len(graph) == n
    assert networkx.is_connected(graph)


def test_ties_on_a_lattice_are_taken_by_index_and_shift():
    points = np.stack(np.meshgrid(*[np.arange(4) / 4] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    edges, shifts = candidate_graph(points, 9, periodic=True)
    # 1/4 and its multiples are exact, so that equal distances are equal numbers
    assert np.concatenate([edges, shifts], axis=1).tolist() == [
        list(row) for row in nearest_by_enumeration(points, 9, (True, True, True))
    ]


def test_two_pores_in_a_periodic_cell_share_tunnels_to_several_images():
    edges, shifts = candidate_graph([[0.1, 0.1, 0.1], [0.3, 0.4, 0.2]], 10, periodic=True)
    assert len(edges) == 8
    assert (edges == [0, 1]).all()
    assert {tuple(s) for s in shifts.tolist()} == set(itertools.product((0, -1), repeat=3))


def test_components_are_joined_by_the_shortest_edge_and_a_second_one_beside_it():
    x = np.array([0.0, 0.01, 0.02, 0.5, 0.51, 0.52])
    points = np.stack([x, 0 * x, 0 * x], axis=1)
    edges, _ = candidate_graph(points, 1)
    between = {tuple(edge) for edge in edges.tolist() if (edge[0] < 3) != (edge[1] < 3)}
    assert between == {(2, 3), (1, 4)}


def test_points_outside_the_cell_are_moved_by_whole_cells():
    points = np.random.default_rng(0).random((20, 3))
    cells = np.random.default_rng(1).integers(-3, 4, points.shape)
    edges, shifts = candidate_graph(points, 6, periodic=True)
    moved_edges, moved_shifts = candidate_graph(points + cells, 6, periodic=True)
    shifts = shifts + cells[edges[:, 0]] - cells[edges[:, 1]]
    assert np.array_equal(moved_edges, edges)
    assert np.array_equal(moved_shifts, shifts)


@pytest.mark.parametrize("n", [0, 1])
def test_nothing_to_join(n):
    edges, shifts = candidate_graph(np.zeros((n, 3)))
    assert edges.shape == (0, 2)
    assert shifts.shape == (0, 3)


def test_canonical_edges_turn_sort_and_drop_duplicates():
    edges = np.array([[3, 1], [0, 2], [1, 3], [1, 3]])
    shifts = np.array([[1, 0, 0], [0, 0, 0], [-1, 0, 0], [0, 0, 0]])
    edges, shifts = canonical_edges(edges, shifts)
    assert edges.tolist() == [[0, 2], [1, 3], [1, 3]]
    assert shifts.tolist() == [[0, 0, 0], [-1, 0, 0], [0, 0, 0]]
