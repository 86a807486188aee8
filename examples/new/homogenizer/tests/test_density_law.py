"""The homogenizer keeps the contract of homogenizers, and its own promises."""

from __future__ import annotations

import numpy as np
import pytest
from my_plugin.density_law import DensityLaw

from sppm_pipeline import Voxels
from sppm_pipeline.testing.contracts import HomogenizerContract
from sppm_pipeline.testing.plain_context import PlainContext


class TestDensityLaw(HomogenizerContract):
    def stages(self):
        return [DensityLaw(), DensityLaw(prefactor=0.5, exponent=1.0, young=200.0, poisson=0.2)]


@pytest.mark.parametrize("fraction", [1.0, 0.5])
def test_the_law(fraction):
    image = Voxels.from_array(np.full((2, 2, 2), fraction, np.float32))
    found = DensityLaw(young=70.0, poisson=0.25).run(PlainContext(), image).summary()
    assert found["E"] == pytest.approx([70 * fraction**2] * 3)
    assert found["nu"]["xy"] == pytest.approx(0.25)
