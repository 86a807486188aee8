"""Voxels at the surface, and the extrapolation to fine grids."""

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.formula import FormulaField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.porosity.fractions import power_share, stiff_share
from sppm_pipeline.services.elastic.refinement import (
    POWERS,
    doubt,
    limit_of_compliance,
    limit_of_grids,
    limit_of_powers,
    mean_thickness,
    power_weights,
    rest_of,
    second_order,
)
from sppm_pipeline.services.elastic.voigt import isotropic
from sppm_pipeline.testing.plain_context import PlainContext


def test_the_rule_favors_neither_side():
    shares = np.linspace(0, 1, 41, dtype=np.float32)
    found = stiff_share(shares)
    assert found + stiff_share(1 - shares) == pytest.approx(np.ones(41))
    assert (found[shares <= 0.25] == 0).all()
    assert (found[shares >= 0.75] == 1).all()
    assert found.dtype == np.float32


def test_the_thickness_of_an_oblique_wall():
    """Across a diagonal of the grid, with fractions from fine samples."""
    n, parts = 24, 8
    along = (np.arange(n * parts) + 0.5) / parts
    place = (along[:, None, None] + along[:, None] + along - 0.5) % n
    solid = (place < 9).astype(np.float32)
    fraction = solid.reshape(n, parts, n, parts, n, parts).mean(axis=(1, 3, 5))
    # this direction cuts sqrt(3) / 1.5 times as many voxels as the mean over all of them
    assert mean_thickness(fraction) == pytest.approx(9 / np.sqrt(3) * 1.5 / np.sqrt(3))
    assert mean_thickness(1 - fraction) == mean_thickness(fraction)
    assert mean_thickness((fraction > 0.5).astype(np.float32)) == np.inf


def test_errors_of_second_order_vanish():
    exact, slope = isotropic(1.0, 0.3), isotropic(0.3, 0.1)
    spacings = [1.0, 2.0, 4 / 3]
    values = [exact + 0.01 * h**2 * slope for h in spacings]
    assert second_order(spacings, values) == pytest.approx(exact)
    limit = limit_of_grids(spacings[:2], values[:2], 10.0)
    assert limit.extrapolated
    assert limit.value == pytest.approx(exact)
    assert limit.error == pytest.approx(0.01 * slope + 0.25 / 10**1.5 * exact)
    assert limit_of_grids(spacings[:2], values[:2], 10.0, contrast=0.0).error == pytest.approx(0.01 * slope)


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
@pytest.mark.parametrize("ratio", [0.0, 1e-6, 0.3, 1.0, 7.0])
def test_powers_of_the_fraction(power, ratio):
    fraction = np.linspace(0, 1, 31)
    share = power_share(fraction, power, ratio)
    assert share[[0, -1]] == pytest.approx([0, 1], abs=1e-12)
    assert (np.diff(share) > 0).all()
    if ratio:  # both materials may change places
        assert 1 - power_share(1 - fraction, power, 1 / ratio) == pytest.approx(share, abs=1e-12)
    else:
        assert share == pytest.approx(fraction**power)
    assert power_share(fraction, power, 0.98) == pytest.approx(fraction, abs=2e-3)


@pytest.mark.parametrize("spacing", [1.75, 2.0, 2.5])
def test_flat_walls_lose_nothing_in_the_limit(spacing):
    """Wherever a wall of unit area, 7 voxels thick, cuts the finer grid: in the mean over all positions."""
    cuts = (np.arange(1000) + 0.5) / 1000
    sizes = [1.0, spacing, spacing, spacing]
    # whole voxels between both surfaces, each of which cuts one voxel in the mean
    found = [7 - h + 2 * h * power_share(cuts, power).mean() for h, power in zip(sizes, POWERS, strict=True)]
    assert found[0] < 6.7
    limit, change = (weights @ found for weights in power_weights(spacing))
    assert limit == pytest.approx(7, rel=1e-6)
    assert change == pytest.approx(0, abs=1e-5)


def test_the_limit_of_powers_and_its_bar():
    exact, slope = isotropic(1.0, 0.3), isotropic(0.1, 0.2)
    values = [exact, exact, exact + slope, exact]
    weights, change = power_weights(2.0)
    limit = limit_of_powers(2.0, values, 4.0)
    assert limit.value == pytest.approx(exact + weights[2] * slope)
    assert limit.error == pytest.approx(0.1 * abs(change[2]) * slope + 0.06 / 4 * limit.value)
    assert limit_of_powers(2.0, [exact] * 4, 4.0, contrast=0.0).error == pytest.approx(0 * exact, abs=1e-12)
    far = limit_of_powers(2.0, [0.1 * exact, exact, exact, exact], 4.0)
    assert not far.extrapolated
    assert far.value == pytest.approx(0.1 * exact)
    assert (np.diag(far.error) > 5 * np.diag(far.value)).all()


def test_doubts_name_the_resolution():
    assert doubt(0.1, "stiffness", 2.0, 32) == ""
    assert "about 94 for 3 %" in doubt(0.15, "stiffness", 1.4, 32)
    assert "about" not in doubt(0.15, "stiffness", 1.4)


def test_what_can_not_be_extrapolated_stays():
    fine = isotropic(0.1, 0.3)
    limit = limit_of_grids([1.0, 2.0], [fine, isotropic(1.0, 0.3)], 5.0)
    assert not limit.extrapolated
    assert limit.value is fine
    assert (np.diag(limit.error) > 5 * np.diag(fine)).all()
    fine[2] = fine[:, 2] = 0
    limit = limit_of_grids([1.0, 2.0], [fine, 1.2 * isotropic(0.1, 0.3)], 5.0)
    assert limit.extrapolated
    assert not limit.value[2].any()
    assert not limit.value[:, 2].any()


# Limits of 96 and 144 voxels of benchmarks/partial_voxels.py
WIDE = [
    {"stage": "sample.mirrored_faces", "total": 95, "share": 0.5},
    {"stage": "sample.dart_throwing", "total": 95},
    {"stage": "connect.mbdst", "degree": [3, 5], "mode": "greedy"},
    {"stage": "field.gaussian", "pore_radius": 0.1075, "tunnel_radius": 0.0658},
]
LIMITS = {
    ("paper", 0.7): 0.03763, ("paper", 0.5): 0.19119, ("wide", 0.3): 0.44301,
    ("stiff", 0.7): 0.14021,
}  # fmt: skip


@pytest.mark.filterwarnings("ignore:.*changes the radii")  # which are of no concern here
@pytest.mark.parametrize(("recipe", "porosity"), LIMITS)
def test_the_modulus_is_right_on_coarse_grids(recipe, porosity):
    """A ramp of the solid fraction, extrapolated from 32 and 16 voxels, gave 17 % too much for the last one."""
    import sppm_pipeline as sppm

    field = sppm.tune.porosity(recipe=WIDE if recipe == "wide" else recipe, target=porosity, seed=1)
    found = HomogenizeVoxel(resolution=32, solver_tolerance=1e-3).run(PlainContext(), field).summary()
    error = abs(found["E_relative"] - LIMITS[recipe, porosity])
    assert error < 0.03 * LIMITS[recipe, porosity]
    assert error < found["E_relative_error"]


@dataclass(frozen=True, eq=False, kw_only=True)
class GyroidSheet(FormulaField):
    """A sheet around the gyroid of the same thickness everywhere, half of the cell."""

    def evaluate(self, x, y, z):
        phases = [2 * np.pi * along for along in (x, y, z)]
        sines, cosines = [np.sin(phase) for phase in phases], [np.cos(phase) for phase in phases]
        value = sum(sines[i] * cosines[i - 2] for i in range(3))
        slope = np.sqrt(sum((cosines[i] * cosines[i - 2] - sines[i] * sines[i - 1]) ** 2 for i in range(3)))
        return np.abs(value) / np.maximum(2 * np.pi * slope, 0.1) - 0.09451277


def test_the_error_bar_of_a_thick_smooth_sheet_covers():
    """A bar that fell with the square of the thickness, 5.5 voxels here, was 1.2 % for an error of 1.6 %."""
    found = HomogenizeVoxel(resolution=32).run(PlainContext(), GyroidSheet()).summary()
    assert abs(found["E_relative"] - 0.2521) < found["E_relative_error"] < 0.03 * 0.2521


def test_error_bars_by_refinement(cell):
    report = HomogenizeVoxel(resolution=27, grids=3).run(PlainContext(), cell)
    assert report.solver["grids"] == [27, 14, 20]
    assert report.solver["extrapolated"]
    fine = HomogenizeVoxel(resolution=48).run(PlainContext(), cell).stiffness
    # the finer grid lies within the bar
    assert abs(fine[0, 0] - report.stiffness[0, 0]) <= report.error[0, 0]
    assert report.summary()["error_relative"] < 0.3
    with pytest.raises(ConfigError, match="coarser"):
        HomogenizeVoxel(resolution=2, grids=3).run(PlainContext(), cell)


def test_walls_of_a_voxel_are_warned_of(run_yaml, summary):
    record, _ = run_yaml(
        "pipeline: [{stage: tune.porosity, recipe: stiff, target: 0.7}, {stage: homogenize.voxel, resolution: 24}]"
    )
    stage = next(stage for stage in record["stages"] if stage["id"] == "homogenize.voxel")
    assert any("voxels thick in the mean" in word for word in stage["warnings"])
    assert any(" for 3 %" in word for word in stage["warnings"])


def test_images_of_fractions_are_extrapolated_as_fields(cell):
    fraction = HomogenizeVoxel(resolution=16).sampled(cell, 1).fraction
    image = Voxels(fraction, (1.0, 1.0, 1.0), True, (True, True, True))
    found = HomogenizeVoxel().run(PlainContext(), image)
    assert found.solver["grids"] == [16, 8, 8, 8]
    field = HomogenizeVoxel(resolution=16).run(PlainContext(), cell)
    assert found.stiffness == pytest.approx(field.stiffness, rel=0.05, abs=0.01)
    whole = Voxels((fraction > 0.5).astype(np.uint8), (1.0, 1.0, 1.0), False, (True, True, True))
    assert HomogenizeVoxel().run(PlainContext(), whole).error is None
    bar = HomogenizeVoxel(grids=2).run(PlainContext(), whole)
    assert bar.solver["grids"] == [8, 16]
    assert bar.error is not None


def test_reciprocals_of_compliances_are_extrapolated():
    compliances = [1 / (3 + 0.2 * h**2) for h in (1.0, 2.0)]
    limit, error = limit_of_compliance([1.0, 2.0], compliances, 5.0)
    assert limit == pytest.approx(1 / 3)
    assert error == pytest.approx(0.2 / 3 + rest_of(5.0))
    rising = [1.0, 1.1]  # stiffer on the finer grid
    limit, error = limit_of_compliance([1.0, 2.0], rising, 5.0)
    assert limit == 1.0
    assert error == pytest.approx(3 * (1 - 1 / 1.1) + rest_of(5.0))
