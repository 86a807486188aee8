"""The check keeps the contract of stages, and its own promises."""

from __future__ import annotations

import numpy as np
import pytest
from my_plugin.dead_ends import CheckDeadEnds

from sppm_pipeline import PoreSet, Rejected, TunnelGraph
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext

PORES = PoreSet.from_array(np.linspace(0.1, 0.9, 5)[:, None].repeat(3, axis=1))
STAR = TunnelGraph.from_arrays(PORES, [[0, 1], [0, 2], [0, 3], [0, 4]])
RING = TunnelGraph.from_arrays(PORES, [[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]])


class TestCheckDeadEnds(StageContract):
    def stages(self):
        return [CheckDeadEnds(), CheckDeadEnds(maximum=0.9)]

    def inputs(self):
        return {"graph": STAR}


@pytest.mark.parametrize(("graph", "count"), [(STAR, 4), (RING, 0)])
def test_what_is_counted(graph, count):
    context = PlainContext()
    CheckDeadEnds().run(context, graph)
    assert context.reported == {"dead_ends": count, "share": count / 5}


def test_too_many_are_rejected():
    CheckDeadEnds(maximum=0.8).run(PlainContext(), STAR)
    with pytest.raises(Rejected, match="80 %"):
        CheckDeadEnds(maximum=0.79).run(PlainContext(), STAR)
