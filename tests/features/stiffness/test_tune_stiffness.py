"""``tune.stiffness``: wished moduli are met by real homogenizations."""

import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.features.stiffness.stages.tune_stiffness import TuneStiffness
from sppm_pipeline.testing.plain_context import PlainContext

HEAD = """
recipes:
  pores:
    - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
    - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
    - {stage: connect.mst}
    - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.06}
  cell:
    - {stage: tune.porosity, recipe: pores, target: 0.5, resolution: 24, tolerance: 0.005}
pipeline:
"""


def test_a_wished_modulus_is_met(run_yaml, summary):
    record, _ = run_yaml(
        HEAD
        + """
  - {stage: tune.stiffness, recipe: cell, target: 0.2, resolution: 14, solver_tolerance: 0.001}
  - {stage: homogenize.voxel, resolution: 14, solver_tolerance: 0.001}
"""
    )
    tuned, checked = summary(record, "tune.stiffness"), summary(record, "homogenize.voxel")
    assert tuned["varied"] == "tune.porosity.target"
    assert 0.3 < tuned["value"] < 0.85
    assert abs(tuned["modulus_error"]) <= 0.01
    assert checked["isotropic"]["E"] == pytest.approx(0.2, rel=0.011)
    assert tuned["homogenizations"] <= 10
    # the error bar is that of the cell that was found
    assert tuned["modulus_grid_error"] == pytest.approx(checked["E_relative_error"])
    entry = next(stage for stage in record["stages"] if stage["id"] == "tune.stiffness")
    said = [warning for warning in entry["warnings"] if "more than `accuracy`" in warning]
    assert bool(said) == (tuned["modulus_grid_error"] > 0.01 * 0.2)
    values = [modulus for _, modulus in tuned["curve"]]
    assert values == sorted(values, reverse=True)  # more void, less stiffness


def test_along_an_axis_and_in_physical_units(recipe):
    context = PlainContext(3)
    stage = TuneStiffness(
        target=300.0, modulus="z", young=2000.0, stress_unit="MPa", resolution=10, solver_tolerance=1e-3,
        vary="field.gaussian.level", low=0.1, high=0.6,
    )  # fmt: skip
    field = stage.run(context, recipe())
    report = HomogenizeVoxel(young=2000.0, stress_unit="MPa", resolution=10, solver_tolerance=1e-3).run(
        PlainContext(), field
    )
    assert report.summary()["E"][2] == pytest.approx(300, rel=0.011)


def test_what_can_not_be_reached_names_the_best(recipe):
    options = {"resolution": 8, "solver_tolerance": 0.01, "vary": "field.gaussian.level", "low": 0.2, "high": 0.3}
    with pytest.raises(DesignError, match=r"nearest is .* at field.gaussian.level = 0\.[23], the bound"):
        TuneStiffness(target=0.999, **options).run(PlainContext(3), recipe())
    with pytest.raises(DesignError, match="homogenizations"):
        TuneStiffness(target=0.3, accuracy=1e-9, evaluations=5, **{**options, "low": 0.05, "high": 0.9}).run(
            PlainContext(3), recipe()
        )


def test_what_is_varied_must_be_there(recipe):
    with pytest.raises(ConfigError, match="no option"):
        TuneStiffness(target=0.1, vary="field.gaussian.nothing").run(PlainContext(), recipe())
    with pytest.raises(ConfigError, match="aim at a porosity"):
        TuneStiffness(target=0.1).run(PlainContext(), recipe())
    with pytest.raises(ConfigError, match="rise"):
        TuneStiffness(target=0.1, low=0.5, high=0.5).check_options()
