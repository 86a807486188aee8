"""The field keeps the contract of fields, and its own promises."""

from __future__ import annotations

import numpy as np
import pytest
from my_plugin.gyroid_sheet import GyroidSheet

from sppm_pipeline.testing.contracts import FieldContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestGyroidSheet(FieldContract):
    def stages(self):
        return [GyroidSheet(), GyroidSheet(periods=2, wall=0.8)]


@pytest.mark.parametrize("wall", [0.2, 0.5])
def test_the_share_of_the_wall(wall):
    solid = GyroidSheet(wall=wall).run(PlainContext()).solid(48)
    assert solid.mean() == pytest.approx(wall / 1.5, abs=0.01)


def test_more_periods_are_the_same_pattern_in_small():
    once, thrice = (GyroidSheet(periods=n).run(PlainContext()) for n in (1, 3))
    assert np.allclose(thrice.sample(36)[:12, :12, :12], once.sample(12), atol=1e-6)
