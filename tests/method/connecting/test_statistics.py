from __future__ import annotations

import networkx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.connecting.statistics import graph_statistics, wraps
from sppm_pipeline.method.connecting.trees import bridge_mask, edge_lengths


def random_edges(n: int, m: int, seed: int) -> np.ndarray:
    """Pairs of different vertices; some repeat."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, n, m)
    return np.sort(np.stack([first, (first + rng.integers(1, n, m)) % n], axis=1), axis=1)


@settings(max_examples=80, deadline=None, derandomize=True)
@given(n=st.integers(2, 25), m=st.integers(0, 40), seed=st.integers(0, 200))
def test_figures_match_networkx(n, m, seed):
    edges = random_edges(n, m, seed)
    shifts = np.random.default_rng(seed).integers(-1, 2, (m, 3))
    points = np.random.default_rng(seed).random((n, 3))
    figures = graph_statistics(points, edges, shifts)
    graph = networkx.MultiGraph()
    graph.add_nodes_from(range(n))
    graph.add_edges_from(edges.tolist())
    bridges = {tuple(sorted(pair)) for pair in networkx.bridges(graph)}
    assert [tuple(edge) for edge in edges[bridge_mask(n, edges)].tolist()] == [
        tuple(edge) for edge in edges.tolist() if tuple(edge) in bridges
    ]
    assert figures.degree_histogram.tolist() == networkx.degree_histogram(graph)
    assert figures.mean_degree == pytest.approx(2 * m / n)
    assert figures.components == networkx.number_connected_components(graph)
    assert figures.loops == m - n + figures.components
    assert figures.bridges == len(bridges)
    assert (figures.pores, figures.tunnels) == (n, m)
    if m:
        lengths = edge_lengths(points, edges, shifts)
        assert (figures.min_length, figures.max_length) == (lengths.min(), lengths.max())
        assert figures.mean_length == lengths.mean()
    else:
        assert np.isnan(figures.mean_length)


def wraps_by_unrolling(n, edges, shifts):
    """A vertex that reaches its own image in a 7 x 7 x 7 block of cells, starting from the middle, cell by cell."""
    found = [False] * 3
    for start in range(n):
        seen = {(start, 0, 0, 0)}
        stack = [(start, 0, 0, 0)]
        while stack:
            v, *cell = stack.pop()
            for (i, j), shift in zip(edges.tolist(), shifts.tolist(), strict=True):
                for a, b, sign in ((i, j, 1), (j, i, -1)):
                    if a == v:
                        image = (b, *(c + sign * s for c, s in zip(cell, shift, strict=True)))
                        if max(map(abs, image[1:])) <= 3 and image not in seen:
                            seen.add(image)
                            stack.append(image)
        for axis in range(3):
            found[axis] |= any(v == start and cell[axis] for v, *cell in seen)
    return tuple(found)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(n=st.integers(2, 5), m=st.integers(0, 7), seed=st.integers(0, 300))
def test_wraps_matches_the_unrolled_lattice(n, m, seed):
    edges = random_edges(n, m, seed)
    # sparse shifts, so that both answers occur, and short ways, so that they fit into the block
    shifts = np.random.default_rng(seed).integers(-1, 2, (m, 3)) * (
        np.random.default_rng(seed + 1).random((m, 3)) < 0.3
    )
    assert wraps(n, edges, shifts) == wraps_by_unrolling(n, edges, shifts)


def test_moving_pores_by_whole_cells_does_not_change_what_wraps():
    points = np.random.default_rng(3).random((30, 3))
    edges, shifts = spanning_subgraph(points, (3, 5), mode="greedy", periodic=(True, True, False))
    assert wraps(30, edges, shifts) == (True, True, False)
    cells = np.random.default_rng(4).integers(-2, 3, (30, 3))
    assert wraps(30, edges, shifts + cells[edges[:, 0]] - cells[edges[:, 1]]) == (True, True, False)


def test_no_pores_at_all():
    figures = graph_statistics(np.zeros((0, 3)), np.zeros((0, 2), np.int64), np.zeros((0, 3), np.int64))
    assert figures.components == figures.loops == figures.tunnels == 0
    assert figures.wraps == (False, False, False)
