"""``homogenize.realizations``: draws differ, sizes are laid, statistics are right."""

import numpy as np
import pytest
from scipy import stats

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.stiffness.stages.homogenize_realizations import HomogenizeRealizations
from sppm_pipeline.testing.plain_context import PlainContext

FAST = {"resolution": 10, "solver_tolerance": 1e-3}


def test_draws_of_a_cell(recipe):
    context = PlainContext(2)
    table = HomogenizeRealizations(draws=4, **FAST).run(context, recipe())
    table.check()
    young = np.array(table.columns["E_x"])
    assert table.columns["cells"] == (1,) * 4
    assert len(set(young)) == 4
    found = context.reported["sizes"]["1"]["E_x"]
    assert found["mean"] == pytest.approx(young.mean())
    assert found["deviation"] == pytest.approx(young.std(ddof=1))
    low, high = stats.t.interval(0.95, 3, young.mean(), stats.sem(young))
    assert found["confidence_95"] == pytest.approx((high - low) / 2)
    again = HomogenizeRealizations(draws=4, **FAST).run(PlainContext(2), recipe())
    assert again.columns == table.columns


def test_one_draw_has_no_spread(recipe):
    context = PlainContext(2)
    HomogenizeRealizations(draws=1, **FAST).run(context, recipe())
    assert context.reported["sizes"]["1"]["E_x"]["deviation"] is None


def test_assemblies_need_a_tile_stage(recipe):
    with pytest.raises(ConfigError, match="lays no cells"):
        HomogenizeRealizations(draws=1, assemblies=(1, 2), **FAST).run(PlainContext(), recipe())


def test_assemblies_in_a_pipeline(run_yaml, summary):
    record, _ = run_yaml(
        """
recipes:
  cell:
    - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
    - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.06}
  assembly:
    - {stage: tileset.wang_3color, recipe: cell, colors: 2, porosity: 0.5, resolution: 24, tolerance: 0.005}
    - {stage: tile.wang_3color, cells: [2, 2, 2], cell: 5 mm}
pipeline:
  - stage: homogenize.realizations
    recipe: assembly
    draws: 3
    assemblies: [1, 2]
    resolution: 10
    solver_tolerance: 0.001
"""
    )
    found = summary(record, "homogenize.realizations")["sizes"]
    assert found["2"]["porosity"]["mean"] == pytest.approx(0.5, abs=0.03)
    assert found["1"]["E_x"]["count"] == found["2"]["E_x"]["count"] == 3
    assert found["2"]["E_x"]["mean"] > 0
