from __future__ import annotations

import io
import json

import networkx
import numpy as np
import pytest

from sppm_pipeline.method.connecting.statistics import networkx_graph

POINTS = np.array([[0.1, 0.2, 0.3], [0.9, 0.2, 0.3], [0.5, 0.5, 0.5]])
EDGES = np.array([[0, 1], [0, 1], [1, 2]])
SHIFTS = np.array([[-1, 0, 0], [0, 0, 0], [0, 0, 0]])


def test_nodes_and_edges_carry_their_figures():
    graph = networkx_graph(POINTS, EDGES, SHIFTS, ["face", "face", "interior"])
    assert graph.nodes[2] == {"x": 0.5, "y": 0.5, "z": 0.5, "region": "interior"}
    assert graph.number_of_edges(0, 1) == 2
    assert graph.edges[0, 1, 0] == {"length": pytest.approx(0.2), "shift": "-1 0 0"}
    assert "region" not in networkx_graph(POINTS, EDGES, SHIFTS).nodes[0]


def test_survives_graphml_and_json():
    graph = networkx_graph(POINTS, EDGES, SHIFTS, ["face", "face", "interior"])
    buffer = io.BytesIO()
    networkx.write_graphml(graph, buffer)
    buffer.seek(0)
    back = networkx.read_graphml(buffer, node_type=int)
    assert dict(back.nodes(data=True)) == dict(graph.nodes(data=True))
    assert sorted(edge[2]["shift"] for edge in back.edges(data=True)) == ["-1 0 0", "0 0 0", "0 0 0"]
    data = json.loads(json.dumps(networkx.node_link_data(graph, edges="edges")))
    again = networkx.node_link_graph(data, edges="edges")
    assert dict(again.nodes(data=True)) == dict(graph.nodes(data=True))
    assert list(again.edges(data=True)) == list(graph.edges(data=True))
