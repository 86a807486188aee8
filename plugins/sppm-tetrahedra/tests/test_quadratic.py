"""Nodes in the middle of edges."""

import numpy as np
import pytest
from sppm_tetrahedra.numerics.quality import EDGES, minimum_jacobian, volumes, with_mid_nodes
from sppm_tetrahedra.stages.mesh_isosurface_stuffing import stuff
from sppm_tetrahedra.volume_mesh import matched_nodes


def test_each_edge_gets_one_node_in_its_middle(noise):
    mesh = stuff(noise(6, 0), True)
    nodes, cells = with_mid_nodes(mesh.nodes, mesh.tets)
    ends = cells[:, EDGES]
    assert np.array_equal(nodes[cells[:, 4:]], (nodes[ends[..., 0]] + nodes[ends[..., 1]]) / 2)
    edges = {tuple(sorted(e)) for e in ends.reshape(-1, 2).tolist()}
    assert len(nodes) == len(mesh.nodes) + len(edges)
    assert np.array_equal(cells[:, :4], mesh.tets)
    # six times the volume everywhere, as the edges are straight
    assert np.allclose(minimum_jacobian(nodes, cells), 6 * volumes(nodes, cells))
    box = np.array([[0, 0, 0], [6, 6, 6.0]])
    standing = matched_nodes(nodes, box)
    apart = nodes - nodes[standing]
    assert set(np.unique(apart)) == {0.0, 6.0}


def test_a_bent_edge_lowers_the_jacobian():
    nodes, cells = with_mid_nodes(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]), np.array([[0, 1, 2, 3]]))
    assert minimum_jacobian(nodes, cells) == pytest.approx(1)
    for reach, positive in ((0.1, True), (0.3, False)):
        bent = nodes.copy()
        bent[cells[0, 4], 0] += reach  # towards the end of its edge; a quarter is where it folds
        assert (minimum_jacobian(bent, cells)[0] > 0) == positive
