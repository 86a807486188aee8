"""A cloud of pores is joined by any connector: one connected graph, whatever the windows."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from scipy.spatial import cKDTree

from sppm_pipeline.method.connecting.trees import canonical_edges, component_labels, edge_lengths
from sppm_pipeline.method.families.cloud import Piece
from sppm_pipeline.method.families.connector import Connector
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

TORUS = (True, True, True)
BOX = (False, False, False)


@dataclass(frozen=True, kw_only=True)
class Near(Connector):
    """Every pair that is nearer than a distance."""

    name: ClassVar[str] = "connect.near"
    reach: float = 0.55

    def join(self, rng, piece):
        assert not piece.periodic
        edges = cKDTree(piece.points).query_pairs(self.reach, output_type="ndarray")
        return edges, np.zeros((len(edges), 3), int)


def within(cloud, reach):
    """All pairs nearer than a distance, images included."""
    box = np.where(cloud.periodic, cloud.lattice, 1e9)
    edges = cKDTree(cloud.points, boxsize=box).query_pairs(reach, output_type="ndarray").astype(np.int64)
    steps = cloud.points[edges[:, 1]] - cloud.points[edges[:, 0]]
    return canonical_edges(edges, (-np.rint(steps / box) * cloud.period).astype(np.int64))


@pytest.mark.parametrize("periodic", [BOX, TORUS, (True, False, True)])
def test_windows_find_what_a_local_rule_finds_at_once(monkeypatch, random_cloud, periodic):
    monkeypatch.setattr("sppm_pipeline.method.families.connector.WINDOW_PORES", 500)
    cloud = random_cloud((4, 3, 5), 1500, periodic)
    context = PlainContext(1)
    edges, shifts = Near().join_cloud(context, cloud)
    assert len(context.progress_calls) > 8
    assert context.reported == {"bridging_tunnels": 0}
    for mine, whole in zip((edges, shifts), within(cloud, 0.55), strict=True):
        assert np.array_equal(mine, whole)


def test_what_falls_apart_is_joined_by_the_shortest_edges(sorted_cloud):
    rng = np.random.default_rng(4)
    centers = np.array([[0.5, 0.5, 0.5], [3.5, 0.5, 0.5], [0.5, 3.2, 0.5], [3.4, 3.4, 3.4]])
    cloud = sorted_cloud(np.repeat(centers, 40, axis=0) + 0.1 * rng.random((160, 3)), (4, 4, 4))
    context = PlainContext(1)
    edges, shifts = Near(reach=0.2).join_cloud(context, cloud)
    assert component_labels(160, edges).max() == 0
    assert context.reported == {"bridging_tunnels": 3}
    long = np.sort(edge_lengths(cloud.points, edges, shifts))[-3:]
    labels = component_labels(160, within(cloud, 0.2)[0])
    gaps = [
        cKDTree(cloud.points[labels == a]).query(cloud.points[labels == b])[0].min() for a in range(4) for b in range(a)
    ]
    assert long[0] == pytest.approx(min(gaps))
    assert (shifts == 0).all()


def test_one_piece_is_joined_at_once(random_cloud):
    asked = []

    @dataclass(frozen=True, kw_only=True)
    class Chain(Connector):
        name: ClassVar[str] = "connect.chain"

        def join(self, rng, piece: Piece):
            asked.append(piece)
            chain = np.arange(len(piece.points) - 1)
            return np.stack([chain, chain + 1], 1), np.tile([0, 1, 0], (len(chain), 1)) * piece.periodic

    box = random_cloud((2, 3, 1), 60)
    edges, shifts = Chain().join_cloud(PlainContext(1), box)
    assert len(edges) == 59
    assert not shifts.any()
    assert not asked[0].periodic
    assert np.array_equal(asked[0].points, box.points)
    torus = random_cloud((2, 2, 2), 60, TORUS)
    edges, shifts = Chain().join_cloud(PlainContext(1), torus)
    assert asked[1].periodic
    assert asked[1].cell.fraction(Length(0.1)) == 0.05  # of the whole cube
    assert np.array_equal(asked[1].points, torus.points / 2)
    assert (shifts == [0, 2, 0]).all()


@pytest.mark.parametrize(
    ("made", "says"),
    [
        ((np.zeros((3, 3)), np.zeros((3, 3))), "must return edges"),
        ((np.zeros((3, 2)), np.zeros((2, 3))), "must return edges"),
        (([[0, 99]], [[0, 0, 0]]), "not in its piece"),
    ],
)
def test_a_connector_that_returns_nonsense_is_told(random_cloud, made, says):
    @dataclass(frozen=True, kw_only=True)
    class Wrong(Connector):
        name: ClassVar[str] = "connect.wrong"

        def join(self, rng, piece):
            return made

    with pytest.raises(ValueError, match=says):
        Wrong().join_cloud(PlainContext(1), random_cloud((1, 1, 1), 20))


def test_a_cloud_of_one_pore_or_none_has_no_edges(random_cloud):
    for pores in (0, 1):
        edges, shifts = Near().join_cloud(PlainContext(1), random_cloud((1, 1, 1), pores))
        assert edges.shape == (0, 2)
        assert shifts.shape == (0, 3)
