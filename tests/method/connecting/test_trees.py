from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.csgraph import minimum_spanning_tree as csgraph_tree

from sppm_pipeline.method.connecting.trees import component_labels, edge_lengths, kruskal, minimum_spanning_tree


@settings(max_examples=40, deadline=None, derandomize=True)
@given(n=st.integers(2, 60), seed=st.integers(0, 100), periodic=st.tuples(st.booleans(), st.booleans(), st.booleans()))
def test_tree_is_as_short_as_that_of_csgraph(n, seed, periodic):
    points = np.random.default_rng(seed).random((n, 3))
    steps = points[None] - points[:, None]
    steps -= np.where(periodic, np.rint(steps), 0)
    distances = np.sqrt((steps**2).sum(axis=2))
    edges, shifts = minimum_spanning_tree(points, periodic=periodic)
    assert edges.shape == (n - 1, 2)
    assert component_labels(n, edges).max() == 0
    assert edge_lengths(points, edges, shifts).sum() == pytest.approx(csgraph_tree(distances).sum())
    i, j = np.triu_indices(n, 1)
    pairs = np.stack([i, j], axis=1)
    lengths = distances[i, j]
    assert lengths[kruskal(n, pairs, np.argsort(lengths))].sum() == pytest.approx(csgraph_tree(distances).sum())


@settings(max_examples=40, deadline=None, derandomize=True)
@given(n=st.integers(1, 30), m=st.integers(0, 40), seed=st.integers(0, 100))
def test_component_labels_match_csgraph(n, m, seed):
    edges = np.random.default_rng(seed).integers(0, n, (m, 2))
    count, labels = connected_components(csr_array((np.ones(m), edges.T), shape=(n, n)), directed=False)
    ours = component_labels(n, edges)
    assert ours.max() + 1 == count
    assert len(set(zip(ours.tolist(), labels.tolist(), strict=True))) == count
    first = [int(np.flatnonzero(ours == c)[0]) for c in range(count)]
    assert first == sorted(first)


@pytest.mark.parametrize("n", [0, 1])
def test_no_tree_without_two_pores(n):
    edges, shifts = minimum_spanning_tree(np.zeros((n, 3)))
    assert edges.shape == (0, 2)
    assert shifts.shape == (0, 3)


def test_tree_takes_the_image_across_the_border():
    edges, shifts = minimum_spanning_tree([[0.05, 0.5, 0.5], [0.95, 0.5, 0.5]], periodic=True)
    assert edges.tolist() == [[0, 1]]
    assert shifts.tolist() == [[-1, 0, 0]]
