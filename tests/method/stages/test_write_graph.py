"""The written graph holds the structure: what is rebuilt from the file has its tunnels and its porosity."""

import json

import networkx
import numpy as np
import pytest

from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.nouns.tunnels import TunnelGraph
from sppm_pipeline.method.stages.field_gaussian import GaussianField
from sppm_pipeline.method.stages.write_graph import WriteGraph
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.services.grid import cell_centers
from sppm_pipeline.testing.plain_context import PlainContext

FIELD = GaussianField(pore_radius=Length(0.12), tunnel_radius=Length(0.05))


def read_back(path):
    """Pores, tunnels and the lengths that the file states, as its documentation says how to read them."""
    if path.suffix == ".json":
        found = networkx.node_link_graph(json.loads(path.read_text()), edges="edges")
    else:
        found = networkx.read_graphml(path, node_type=int)
    nodes = sorted(found)
    pores = PoreSet.from_array([[found.nodes[v][axis] for axis in "xyz"] for v in nodes])
    edges, shifts, lengths = [], [], []
    for a, b, known in found.edges(data=True):
        edges.append(sorted((int(a), int(b))))
        shifts.append([int(step) for step in known["shift"].split()])
        lengths.append(known["length"])
    return TunnelGraph.from_arrays(pores, edges, shifts), np.array(lengths)


@pytest.mark.parametrize("name", ["graph.graphml", "graph.json"])
def test_a_structure_rebuilt_from_the_file_is_the_same(cell, tmp_path, name):
    graph = cell.graph
    turned = (graph.edges[:, 0] > graph.edges[:, 1]) & graph.shift.any(1)
    assert turned.sum() > 5  # connectors through a high face, whose shift depends on the direction
    WriteGraph(path=name).run(PlainContext(directory=tmp_path), graph)
    again, lengths = read_back(tmp_path / name)
    assert np.allclose(again.lengths(), lengths)
    assert np.allclose(np.sort(lengths), np.sort(graph.lengths()))
    fields = [FIELD.run(PlainContext(1), tunnels).sample(cell_centers(24)) for tunnels in (graph, again)]
    np.testing.assert_allclose(fields[1], fields[0], atol=1e-5)
    assert np.mean(fields[1] > 0) == pytest.approx(np.mean(fields[0] > 0), abs=1e-4)
