"""Connectors on a lattice of blocks: degrees, one component, length, and no trace of regions, threads or windows."""

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.connecting import regional
from sppm_pipeline.method.connecting.bounded import spanning_subgraph
from sppm_pipeline.method.connecting.trees import component_labels, edge_lengths, minimum_spanning_tree
from sppm_pipeline.method.stages.connect_mbdst import BoundedDegreeSubgraph
from sppm_pipeline.method.stages.connect_mst import MinimumSpanningTree
from sppm_pipeline.method.stages.connect_relative_neighbors import RelativeNeighbors
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.plain_context import PlainContext

PERIODIC = [(False, False, False), (True, True, True), (True, False, True)]


def checked(cloud, edges, shifts, degree):
    """The total length of a graph that keeps what every connector promises."""
    n = len(cloud.points)
    found = np.bincount(edges.ravel(), minlength=n)
    assert degree[0] <= found.min()
    assert found.max() <= degree[1]
    assert component_labels(n, edges).max() == 0
    assert (edges[:, 0] < edges[:, 1]).all()
    assert len(np.unique(np.hstack([edges, shifts]), axis=0)) == len(edges)
    period = cloud.period.astype(int)
    assert not shifts[:, period == 0].any()
    assert not (shifts % np.maximum(period, 1)).any()
    length = edge_lengths(cloud.points, edges, shifts)
    assert length.max() < 4 * cloud.spacing
    return length.sum()


@pytest.mark.parametrize(
    ("mode", "degree", "periodic"),
    [
        *(("greedy", (3, 5), periodic) for periodic in PERIODIC),
        ("greedy", (2, 3), PERIODIC[1]),
        ("greedy", (1, 3), PERIODIC[1]),
        ("exact", (3, 5), PERIODIC[2]),
    ],
)
def test_regions_are_about_as_good_as_the_whole(monkeypatch, random_cloud, mode, degree, periodic):
    monkeypatch.setattr(regional, "WHOLE", 200)
    monkeypatch.setattr(regional, "GREEDY_REGION", 400)
    cloud = random_cloud((3, 4, 2), 600, periodic, seed=3)
    stage = BoundedDegreeSubgraph(mode=mode, degree=degree)
    length = checked(cloud, *stage.join_cloud(PlainContext(1), cloud), degree)
    whole = spanning_subgraph(cloud.points, degree, mode=mode, periodic=cloud.period.tolist())
    assert length <= 1.02 * edge_lengths(cloud.points, *whole).sum()


def test_loops_that_leave_a_region_are_seen(monkeypatch, random_cloud):
    """With degrees [2, 3] most do: if ways beyond the region do not count, graphs come out 5 % longer."""
    monkeypatch.setattr(regional, "WHOLE", 200)
    monkeypatch.setattr(regional, "GREEDY_REGION", 150)
    for seed in range(3):
        cloud = random_cloud((3, 4, 2), 600, PERIODIC[seed % 2], seed=seed)
        stage = BoundedDegreeSubgraph(mode="greedy", degree=(2, 3))
        length = checked(cloud, *stage.join_cloud(PlainContext(1), cloud), (2, 3))
        whole = spanning_subgraph(cloud.points, (2, 3), mode="greedy", periodic=cloud.period.tolist())
        assert length <= 1.02 * edge_lengths(cloud.points, *whole).sum()


@pytest.mark.parametrize("period", [(0, 0, 0), (4, 5, 3), (1, 0, 2)])
@pytest.mark.parametrize("offset", [0.0, 0.25])
def test_regions_that_touch_have_different_colors(period, offset):
    period = np.array(period, float)
    cut = regional.Cut(np.zeros(3), np.ones(3), np.array([4, 5, 3]), offset)
    shape, colors = cut.shape(period), cut.colors(period)
    assert shape.tolist() == [n + (offset > 0 and not p) for n, p in zip((4, 5, 3), period, strict=True)]
    places = np.argwhere(np.ones(shape, bool))
    for region, place in enumerate(places):
        gap = np.abs(places - place)
        gap = np.where(period > 0, np.minimum(gap, shape - gap), gap)
        beside = np.flatnonzero((gap <= 1).all(axis=1) & (gap > 0).any(axis=1))
        assert np.array_equal(cut.around(region, period), beside)
        assert (colors[beside] != colors[region]).all()


def test_threads_change_nothing(monkeypatch, random_cloud):
    monkeypatch.setattr(regional, "WHOLE", 150)
    monkeypatch.setattr(regional, "GREEDY_REGION", 150)
    cloud = random_cloud((3, 2, 2), 400, (True, True, True), seed=4)
    for stage in (
        BoundedDegreeSubgraph(mode="greedy"),
        BoundedDegreeSubgraph(mode="greedy", degree=(2, 3)),
        BoundedDegreeSubgraph(mode="exact"),
        RelativeNeighbors(),
    ):
        first, second = (stage.join_cloud(PlainContext(1, threads=threads), cloud) for threads in (1, 3))
        assert np.array_equal(first[0], second[0])
        assert np.array_equal(first[1], second[1])


@pytest.mark.parametrize("mode", ["greedy", "exact"])
def test_a_small_cloud_is_joined_as_one_piece(random_cloud, mode):
    cloud = random_cloud((3, 2, 1), 300, (True, False, True), seed=5)
    edges, shifts = BoundedDegreeSubgraph(mode=mode).join_cloud(PlainContext(1), cloud)
    checked(cloud, edges, shifts, (3, 5))
    whole = spanning_subgraph(cloud.points, (3, 5), mode=mode, periodic=(3, 0, 1))
    assert np.array_equal(edges, whole[0])
    assert np.array_equal(shifts, whole[1])


@pytest.mark.parametrize("periodic", PERIODIC)
def test_the_tree_of_a_cloud_is_that_of_all_pairs(random_cloud, periodic):
    cloud = random_cloud((2, 3, 2), 700, periodic, seed=6)
    edges, shifts = MinimumSpanningTree().join_cloud(PlainContext(1), cloud)
    whole = minimum_spanning_tree(cloud.points, periodic=cloud.period.tolist())
    assert np.array_equal(edges, whole[0])
    assert np.array_equal(shifts, whole[1])


@pytest.mark.parametrize("periodic", PERIODIC)
def test_relative_neighbors_hold_the_degrees_they_report(random_cloud, periodic):
    cloud = random_cloud((2, 3, 2), 900, periodic, seed=7)
    context = PlainContext(1)
    edges, shifts = RelativeNeighbors().join_cloud(context, cloud)
    over = context.reported["pores_over_degree"]
    checked(cloud, edges, shifts, (3, 5 + (over > 0)))
    assert over == (np.bincount(edges.ravel()) > 5).sum()


@pytest.mark.parametrize("given", [{"two_edge_connected": True}, {"clearance": Length(0.01)}])
def test_what_regions_cant_promise_is_refused(random_cloud, given):
    cloud = random_cloud((4, 4, 4), 2100, spacing=0.1)
    with pytest.raises(DesignError, match="can't be promised for 2100 pores"):
        BoundedDegreeSubgraph(mode="greedy", **given).join_cloud(PlainContext(1), cloud)


def test_bounds_that_no_change_near_by_meets_are_refused(monkeypatch, random_cloud):
    monkeypatch.setattr(regional, "WHOLE", 100)
    cloud = random_cloud((2, 2, 2), 301)
    with pytest.raises(DesignError, match="can't"):
        BoundedDegreeSubgraph(mode="greedy", degree=(3, 3)).join_cloud(PlainContext(1), cloud)
