"""Trees and bounded-degree graphs: degrees, pieces in one, connectors to the nearest pore."""

import networkx
import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.nouns.pores import PoreSet
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.sample_dart_throwing import DartThrowing
from sppm_pipeline.method.stages.sample_mirrored_faces import MirroredFaces
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.nouns.palette import Palette
from sppm_pipeline.testing.plain_context import PlainContext

PALETTE = Palette(2, (2, 2, 2))


@pytest.fixture(scope="module")
def pores():
    context = PlainContext(1, palette=PALETTE)
    faces = MirroredFaces(count=30, spacing=Length(0.15)).run(context, None)
    return DartThrowing(count=30, spacing=Length(0.17)).run(context, faces)


@pytest.fixture(scope="module")
def torus():
    return DartThrowing(count=60, spacing=Length(0.15)).run(PlainContext(2), None)


def joined(graph, piece):
    """The graph of one piece."""
    own = graph.pores.piece[graph.edges]
    found = networkx.Graph()
    found.add_nodes_from(graph.pores.indices(piece).tolist())
    found.add_edges_from(graph.edges[(own == piece).all(1)].tolist())
    return found


@pytest.mark.parametrize("mode", ["exact", "greedy"])
@pytest.mark.parametrize("degree", [(1, 4), (3, 5)])
def test_degrees_and_pieces(pores, mode, degree):
    context = PlainContext(1, palette=PALETTE)
    graph = BoundedDegreeSubgraph(degree=degree, mode=mode).run(context, pores)
    graph.check()
    assert context.reported["faces_with_relaxed_degree"] == 0
    for piece in range(8):
        found = joined(graph, piece)
        assert networkx.is_connected(found)
        degrees = [d for _, d in found.degree()]
        assert degree[0] <= min(degrees) <= max(degrees) <= degree[1]


def test_small_faces_relax_the_degree():
    context = PlainContext(1)
    faces = MirroredFaces(count=9, spacing=Length(0.2)).run(context, None)
    pores = DartThrowing(count=12).run(context, faces)
    graph = BoundedDegreeSubgraph(degree=(3, 5), mode="greedy").run(context, pores)
    assert context.reported["faces_with_relaxed_degree"] == 3
    for piece in (1, 2, 3):
        assert sorted(d for _, d in joined(graph, piece).degree()) == [2, 2, 2]


def test_the_tree_is_the_shortest(pores):
    graph = MinimumSpanningTree().run(PlainContext(1, palette=PALETTE), pores)
    for piece in range(8):
        own = joined(graph, piece)
        assert networkx.is_tree(own)
        index = pores.indices(piece)
        full = networkx.Graph()
        for i in index:
            for j in index[index > i]:
                full.add_edge(int(i), int(j), weight=float(np.linalg.norm(pores.centers[i] - pores.centers[j])))
        best = networkx.minimum_spanning_tree(full).size("weight")
        mine = sum(full.edges[e]["weight"] for e in own.edges)
        assert mine == pytest.approx(best)


def test_modes_cost_what_they_promise(pores):
    def length(mode):
        graph = BoundedDegreeSubgraph(mode=mode).run(PlainContext(1, palette=PALETTE), pores)
        start, end = graph.segments()
        return np.linalg.norm(end - start, axis=1).sum()

    exact, greedy = (length(mode) for mode in ("exact", "greedy"))
    assert exact <= greedy + 1e-9
    assert greedy <= 1.1 * exact


@pytest.mark.parametrize("stage", [MinimumSpanningTree(), BoundedDegreeSubgraph(mode="greedy")])
def test_every_face_pore_leads_to_its_nearest_interior_pore_on_both_sides(pores, stage):
    graph = stage.run(PlainContext(1, palette=PALETTE), pores)
    piece = pores.piece[graph.edges]
    crossing = piece[:, 0] != piece[:, 1]
    start, end = (v[crossing] for v in graph.segments())
    inside, outside = piece[crossing].T
    face_pores = int((pores.piece >= 2).sum())
    assert crossing.sum() == face_pores * 2 * 2
    assert graph.summary()["connectors"] == crossing.sum()
    for s, e, t in zip(start, end, inside, strict=True):
        own = pores.of_piece(t)
        assert np.linalg.norm(s - e) == pytest.approx(np.linalg.norm(own - e, axis=1).min())
    axis = pores.axis_of_piece()[outside]
    assert set(end[np.arange(len(axis)), axis]) == {0.0, 1.0}
    assert np.array_equal(graph.shift[crossing].sum(1), end[np.arange(len(axis)), axis])
    assert (graph.shift[~crossing] == 0).all()


def test_connector_clearance_takes_the_nearest_or_the_second(pores):
    palette = PlainContext(1, palette=PALETTE)
    plain = BoundedDegreeSubgraph(mode="greedy").run(palette, pores)
    clear = BoundedDegreeSubgraph(mode="greedy", connector_clearance=Length(0.2)).run(palette, pores)
    a, b = (set(map(tuple, np.hstack([g.edges, g.shift]).tolist())) for g in (plain, clear))
    assert len(a) == len(b)
    assert a != b
    for i, j, *shift in b - a:
        distance = np.sort(np.linalg.norm(pores.of_piece(pores.piece[i]) - pores.centers[j] - shift, axis=1))
        assert np.linalg.norm(pores.centers[i] - pores.centers[j] - shift) == pytest.approx(distance[1])


def test_a_lone_cell_without_faces_is_joined_across_its_borders(torus):
    for stage in (MinimumSpanningTree(), BoundedDegreeSubgraph(mode="greedy")):
        graph = stage.run(PlainContext(1), torus)
        graph.check()
        assert (graph.shift != 0).any()
        assert graph.summary()["connectors"] == 0
        start, end = graph.segments()
        assert np.linalg.norm(end - start, axis=1).max() < 0.5


def test_two_edge_connected(torus):
    graph = BoundedDegreeSubgraph(degree=(1, 5), two_edge_connected=True).run(PlainContext(1), torus)
    assert not networkx.has_bridges(networkx.Graph(graph.edges.tolist()))
    tree = BoundedDegreeSubgraph(degree=(1, 5)).run(PlainContext(1), torus)
    assert networkx.has_bridges(networkx.Graph(tree.edges.tolist()))


def test_degrees_in_the_wrong_order():
    with pytest.raises(ConfigError, match="order"):
        BoundedDegreeSubgraph(degree=(5, 3)).check_options()


@pytest.mark.parametrize(
    ("mode", "pores", "used"),
    [
        ("exact", 3000, "exact"), ("exact", 3001, "greedy"), ("greedy", 10**6, "greedy"),
    ],
)  # fmt: skip
def test_modes_give_way_where_they_would_take_too_long(mode, pores, used):
    assert BoundedDegreeSubgraph(mode=mode).mode_for(pores) == used
    assert BoundedDegreeSubgraph(mode=mode, clearance=Length(0.01)).mode_for(pores) == mode


def test_the_former_name_of_a_mode_makes_the_same_graph_and_warns(torus):
    graph = BoundedDegreeSubgraph().run(PlainContext(1), torus)
    context = PlainContext(1)
    assert BoundedDegreeSubgraph(mode="lp_fix").run(context, torus).digest() == graph.digest()
    assert context.warnings == ["option 'mode': `lp_fix` is now `exact`; the old name works in this version"]


def test_another_mode_is_told(monkeypatch):
    monkeypatch.setattr("sppm_pipeline.method.stages.connect_mbdst.MAX_EXACT", 11)
    pores = PoreSet.from_array(np.random.default_rng(3).random((12, 3)))
    context = PlainContext(1)
    made = BoundedDegreeSubgraph(mode="exact").run(context, pores)
    assert context.warnings == [
        "option 'mode': a piece of 12 pores is joined by `mode: greedy`, as `exact` would take too long"
    ]
    assert made.digest() == BoundedDegreeSubgraph(mode="greedy").run(PlainContext(1), pores).digest()
    smaller, quiet = PoreSet.from_array(pores.centers[:11]), PlainContext(1)
    BoundedDegreeSubgraph(mode="exact").run(quiet, smaller)
    assert quiet.warnings == []
