"""Parts of the graph of a layout against a graph that is written out pore by pore."""

import itertools

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sppm_pipeline.method.assembly.contents import TilingArrays
from sppm_pipeline.method.connectivity.laid_graph import parts_of_layout


def obvious(piece, edges, shift, interiors, colors, tiling):
    """Every pore at every place a node of its own, joined tunnel by tunnel."""
    first_color = np.concatenate([[0], np.cumsum(colors)])
    nodes, links = {}, []

    def node(place, pore):
        return nodes.setdefault((*place, pore), len(nodes))

    shape = tiling.interior.shape
    for cell in itertools.product(*map(range, shape)):
        t = tiling.interior[cell]
        for pore in np.flatnonzero(piece == t) if t >= 0 else ():
            node((-1, *cell), pore)
        for (i, j), s in zip(edges, shift, strict=True) if t >= 0 else ():
            if piece[i] != t:
                continue
            if piece[j] == t:
                links.append((node((-1, *cell), i), node((-1, *cell), j)))
                continue
            axis = int(np.searchsorted(first_color, piece[j] - interiors, side="right")) - 1
            at = list(cell)
            at[axis] += s[axis]
            if tiling.faces[axis][tuple(at)] == piece[j] - interiors - first_color[axis]:
                at[axis] %= shape[axis] if tiling.periodic else 10**9
                links.append((node((-1, *cell), i), node((axis, *at), j)))
    for axis, faces in enumerate(tiling.faces):
        for at in itertools.product(*map(range, faces.shape)):
            if tiling.periodic and at[axis] == shape[axis]:
                continue
            own = interiors + first_color[axis] + faces[at]
            for pore in np.flatnonzero(piece == own) if faces[at] >= 0 else ():
                node((axis, *at), pore)
            for i, j in edges:
                if faces[at] >= 0 and piece[i] == piece[j] == own:
                    links.append((node((axis, *at), i), node((axis, *at), j)))
    a, b = np.array(links).reshape(-1, 2).T
    return connected_components(coo_array((np.ones(len(a)), (a, b)), (len(nodes),) * 2), directed=False)[0]


@pytest.mark.parametrize(("seed", "periodic"), [(s, p) for s in range(6) for p in (False, True)])
def test_as_the_graph_written_out(seed, periodic):
    rng = np.random.default_rng(seed)
    interiors, colors = 3, (2, 1, 2)
    piece = np.sort(rng.integers(0, interiors + sum(colors), 40))
    axis_of = np.repeat([-1, 0, 1, 2], [interiors, *colors])
    pairs, shifts = [], []
    for i, j in itertools.product(range(40), repeat=2):
        inside = piece[i] < interiors <= piece[j]
        if rng.random() < (0.03 if inside else 0.2) and ((i < j and piece[i] == piece[j]) or inside):
            pairs.append((i, j))
            shifts.append(np.eye(3, dtype=int)[axis_of[piece[j]]] * rng.integers(0, 2) if inside else np.zeros(3, int))
    interior = rng.integers(-1, interiors, (3, 2, 2)).astype(np.int32)
    faces = []
    for axis in range(3):
        shape = [n + (a == axis) for a, n in enumerate(interior.shape)]
        drawn = rng.integers(0, colors[axis], shape).astype(np.int32)
        if periodic:
            np.moveaxis(drawn, axis, 0)[-1] = np.moveaxis(drawn, axis, 0)[0]
        faces.append(drawn)
    tiling = TilingArrays(interior, tuple(faces), periodic)
    given = (piece, np.array(pairs), np.array(shifts), interiors, colors, tiling)
    found = parts_of_layout(*given)
    assert found == obvious(*given)
    assert found > 1


def test_blocks_without_faces_are_one_graph():
    tiling = TilingArrays(
        np.zeros((1, 1, 1), np.int32), tuple(np.full(s, -1, np.int32) for s in ((2, 1, 1), (1, 2, 1), (1, 1, 2))), True
    )
    edges, piece = np.array([[0, 1], [2, 3]]), np.zeros(5, int)
    assert parts_of_layout(piece, edges, np.zeros((2, 3), int), 1, (0, 0, 0), tiling) == 3
