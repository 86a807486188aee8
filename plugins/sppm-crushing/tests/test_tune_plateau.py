"""``tune.plateau``: a wished plateau stress is met by blocks that are crushed."""

from dataclasses import dataclass

import numpy as np
import pytest
from sppm_crushing.stages.crush_voxel import CrushVoxel
from sppm_crushing.stages.tune_plateau import TunePlateau

from sppm_pipeline.errors import DesignError
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.stage import Recipe
from sppm_pipeline.testing.plain_context import PlainContext

OPTIONS = {"resolution": 6, "rate": 0.04, "yield_stress": 0.05}


@dataclass(frozen=True, eq=False)
class Column(ScalarField):
    """A column along z."""

    width: float

    @property
    def cells(self):
        return (1, 1, 1)

    @property
    def periodic(self):
        return True

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (np.abs(grid.axis(axis) - 0.5) for axis in range(3))
        return (np.maximum(x[:, None, None], y[:, None]) + 0 * z - self.width / 2).astype(np.float32)


class Columns(Recipe):
    name = "columns"

    def options(self):
        return {"column": {"porosity": 0.5}}

    def run(self, context, *, palette=None, attempt=0, options=None):
        return Column((1 - options["column"]["porosity"]) ** 0.5)


def test_a_wished_plateau_is_met():
    context = PlainContext()
    # a column of 4 x 4 voxels
    target = CrushVoxel(strain=0.4, **OPTIONS).run(PlainContext(), Column(0.66)).numbers["plateau"]
    made = TunePlateau(target=target, low=0.1, high=0.9, first=2, accuracy=0.3, **OPTIONS).run(context, Columns())
    assert context.reported["varied"] == "column.porosity"
    assert context.reported["plateau"] == pytest.approx(target, rel=0.3)
    assert made.width == (1 - context.reported["value"]) ** 0.5
    again = CrushVoxel(strain=0.4, **OPTIONS).run(PlainContext(), made)
    assert again.numbers["plateau"] == context.reported["plateau"]
    assert again.numbers["work"] == context.reported["work"]


def test_what_can_not_be_reached_says_so():
    with pytest.raises(DesignError, match=r"plateau stress 1 is not reachable for porosity from 0\.3 to 0\.85"):
        TunePlateau(target=1.0, first=2, **OPTIONS).run(PlainContext(), Columns())
