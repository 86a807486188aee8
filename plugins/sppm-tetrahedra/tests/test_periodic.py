"""Representatives of nodes on faces, edges and corners of a periodic box, for meshes from anywhere."""

import itertools

import numpy as np
import pytest
from sppm_tetrahedra.volume_mesh import face_match, loose_parts, matched_nodes

BOX = np.array([[-1.0, 2, 5], [1, 3, 9]])
SIX = [(0, *p, 7) for p in ((1, 3), (3, 2), (2, 6), (6, 4), (4, 5), (5, 1))]
"""A cube, corners counted with x first, around its diagonal."""


def kuhn(n):
    """A box of n^3 cubes cut into six tetrahedra each; opposite faces are copies."""
    index = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    nodes = np.stack(np.meshgrid(*[np.linspace(0, 1, n + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
    tets = []
    for i, j, k in itertools.product(range(n), repeat=3):
        corner = [index[i + (c & 1), j + (c >> 1 & 1), k + (c >> 2)] for c in range(8)]
        tets += [[corner[c] for c in six] for six in SIX]
    return BOX[0] + nodes * (BOX[1] - BOX[0]), np.array(tets), index


def test_a_grid():
    nodes, tets, index = kuhn(3)
    standing = matched_nodes(nodes, BOX)
    expected = index[np.ix_(*[np.arange(4) % 3] * 3)].ravel()
    assert np.array_equal(standing, expected)
    assert np.array_equal(standing[standing], standing)
    match = face_match(nodes, tets, BOX)
    assert match.matched.tolist() == [18, 18, 18]
    assert not match.free.any()
    assert not match.mismatched.any()
    assert np.allclose(match.area, [4, 8, 2])


def test_any_order_and_a_little_noise():
    nodes, _, _ = kuhn(3)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(nodes))
    shaken = (nodes + rng.uniform(-3e-7, 3e-7, nodes.shape))[order]
    standing = matched_nodes(shaken, BOX)
    assert np.array_equal(standing, np.argsort(order)[matched_nodes(nodes, BOX)[order]])


def test_a_node_without_copies_stands_for_itself():
    nodes, _, index = kuhn(2)
    nodes[index[2, 1, 1]] += [0, 0.1, 0]
    standing = matched_nodes(nodes, BOX)
    assert standing[index[2, 1, 1]] == index[2, 1, 1]
    assert standing[index[0, 1, 1]] == index[0, 1, 1]
    assert standing[index[2, 0, 0]] == index[0, 0, 0]


def test_the_first_stands_where_none_is_on_low_faces_only():
    nodes = np.array([[1, 2, 6], [-1, 3, 6], [1, 3, 6], [0, 2.5, 7.0]])
    assert matched_nodes(nodes, BOX).tolist() == [0, 0, 0, 3]


def test_faces_that_do_not_match_clash():
    nodes, tets, index = kuhn(2)
    # the other diagonal in two squares of the high x face
    moved = nodes.copy()
    moved[index[2, 1, 1]] += [0, 0.2, 0.3]
    match = face_match(moved, tets, BOX)
    assert match.mismatched[0] == 12
    assert match.mismatched[1:].tolist() == [0, 0]


def test_a_surface_in_a_face_of_the_box_is_free():
    nodes, tets, _ = kuhn(2)
    kept = tets[nodes[tets].mean(1)[:, 0] < 0]  # the half at low x
    match = face_match(nodes, kept, BOX)
    assert match.free.tolist() == [8, 0, 0]
    assert not match.mismatched.any()


def test_coinciding_nodes_are_refused():
    nodes, _, _ = kuhn(2)
    with pytest.raises(ValueError, match="coincide"):
        matched_nodes(np.concatenate([nodes, nodes[:1]]), BOX)


def test_nothing_on_the_faces():
    assert matched_nodes(np.array([[0.0, 2.5, 7]]), BOX).tolist() == [0]


@pytest.mark.parametrize(
    ("words", "solid", "parts"),
    [
        ("a ball inside", lambda x, y, z: x**2 + y**2 + z**2 < 0.1, 1),
        ("one around the corners of the cell", lambda x, y, z: abs(x) + abs(y) + abs(z) > 1.2, 1),
        ("two balls", lambda x, y, z: abs(abs(x) - 0.25) + abs(y) + abs(z) < 0.15, 2),
        ("a bar along y", lambda x, y, z: x**2 + z**2 < 0.06, 0),
        ("a helix of steps", lambda x, y, z: np.abs((x - y + 0.5) % 1 - 0.5) + abs(z) < 0.2, 0),
    ],
)
def test_parts_that_run_through_are_told_from_loose_ones(words, solid, parts):
    nodes, cells, _ = kuhn(12)
    axis = (np.arange(12) + 0.5) / 12 - 0.5
    inside = solid(*np.meshgrid(axis, axis, axis, indexing="ij")).ravel()
    cells = cells.reshape(-1, 6, 4)[inside].reshape(-1, 4)
    assert loose_parts(nodes, cells, BOX, matched_nodes(nodes, BOX)) == parts, words
