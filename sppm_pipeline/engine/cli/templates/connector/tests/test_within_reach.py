"""The connector keeps the contract of connectors, and its own promises."""

from __future__ import annotations

from my_plugin.within_reach import WithinReach

from sppm_pipeline import PoreSet
from sppm_pipeline.testing.contracts import ConnectorContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestWithinReach(ConnectorContract):
    def stages(self):
        return [WithinReach(), WithinReach(reach=2.0)]


def test_tunnels_are_as_long_as_they_must_be_and_cross_the_faces_of_the_cell():
    pores = PoreSet.from_array([[0.1, 0.5, 0.5], [0.3, 0.5, 0.5], [0.8, 0.5, 0.5]])  # distances .2, .3 and .5
    graph = WithinReach(reach=1.0).run(PlainContext(), pores)
    assert graph.edges.tolist() == [[0, 1], [0, 2]]
    assert graph.shift.tolist() == [[0, 0, 0], [-1, 0, 0]]
    assert len(WithinReach(reach=1.7).run(PlainContext(), pores).edges) == 3
