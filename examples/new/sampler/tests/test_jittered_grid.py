"""The sampler keeps the contract of samplers, and its own promises."""

from __future__ import annotations

import numpy as np
from my_plugin.jittered_grid import JitteredGrid

from sppm_pipeline.testing.contracts import SamplerContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestJitteredGrid(SamplerContract):
    def stages(self):
        return [JitteredGrid(), JitteredGrid(n=1, jitter=1.0)]


def test_without_jitter_pores_lie_in_the_middle_of_their_boxes():
    pores = JitteredGrid(n=2, jitter=0.0).run(PlainContext(), None)
    assert sorted(np.unique(pores.centers)) == [0.25, 0.75]
    assert len(pores.centers) == 8
