"""Pores in two colors: half of each, each one network, with the neighbors that they should have."""

import networkx
import numpy as np
import pytest

from sppm_pipeline.features.sheet.numerics.waves import OWN_SHARE, two_networks
from sppm_pipeline.method.connecting.candidates import candidate_graph


def parts_of(pairs, colors, color):
    graph = networkx.Graph()
    graph.add_nodes_from(np.flatnonzero(colors == color).tolist())
    own = (colors[pairs] == color).all(1)
    graph.add_edges_from(pairs[own].tolist())
    return networkx.number_connected_components(graph)


@pytest.mark.parametrize(("count", "seed"), [(10, 0), (30, 1), (95, 2), (95, 3), (95, 4), (1500, 5)])
def test_each_color_is_one_network_of_half_the_pores(count, seed):
    rng = np.random.default_rng(seed)
    pairs, _ = candidate_graph(rng.random((count, 3)), 12, periodic=True)
    colors = two_networks(pairs, count, rng)
    assert parts_of(pairs, colors, 1) == parts_of(pairs, colors, -1) == 1
    # only pores that were left alone take the color around them
    assert abs(int(colors.sum(dtype=int))) <= max(1, 0.04 * count)
    own = (colors[pairs[:, 0]] == colors[pairs[:, 1]]).mean()
    assert own == pytest.approx(OWN_SHARE, abs=0.05)


def test_parts_without_neighbors_in_common_have_two_networks_each():
    ring = np.array([[i, (i + 1) % 12] for i in range(12)] + [[i, (i + 2) % 12] for i in range(12)])
    pairs = np.concatenate([ring, ring + 12])
    colors = two_networks(pairs, 24, np.random.default_rng(0))
    for first in (0, 12):
        for color in (1, -1):
            own = (pairs >= first).all(1) & (pairs < first + 12).all(1)
            here = np.where(np.arange(24) // 12 == first // 12, colors, 0)
            assert parts_of(pairs[own], here, color) == 1


def test_small_parts_side_by_side_do_not_change_places_for_ever():
    # a path of alternating colors can't hold two networks: one color takes all but an end
    pairs = np.array([[i, i + 1] for i in range(9)])
    colors = two_networks(pairs, 10, np.random.default_rng(3))
    assert parts_of(pairs, colors, 1) <= 1
    assert parts_of(pairs, colors, -1) <= 1
