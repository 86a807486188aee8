"""``homogenize.voxel``: inputs, materials, refusals, warnings about cells without a load path."""

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.engine.process import budget
from sppm_pipeline.errors import ConfigError, DesignError, ResourceError
from sppm_pipeline.features.stiffness.stages.homogenize_voxel import HomogenizeVoxel
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.method.part.part import Part
from sppm_pipeline.services.elastic.voigt import from_lame, lame
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


def voxels(values, periodic=(True, True, True), spacing=(1.0, 1.0, 1.0)):
    return Voxels(np.asarray(values), spacing, False, periodic)


def homogenized(source, context=None, **options):
    report = HomogenizeVoxel(**options).run(context or PlainContext(), source)
    report.check()
    return report


def cross():
    """Bars along x and y, nothing along z."""
    values = np.zeros((8, 8, 8), np.uint8)
    values[:, 2:5, 2:5] = values[3:6, :, 2:5] = 1
    return values


class TestContract(StageContract):
    def stages(self):
        return [HomogenizeVoxel(resolution=8, solver_tolerance=0.01)]

    def inputs(self):
        return {"source": voxels(cross())}


def test_a_cell_of_the_paper(cell):
    report = homogenized(cell, resolution=24)
    assert "fractions" in report.method
    assert tuple(report.solver["grid"]) == (24, 24, 24)
    solid = 1 - report.porosity
    bound = solid * from_lame(*lame(1.0, 0.3))
    assert np.linalg.eigvalsh(report.stiffness)[0] > 0
    assert np.linalg.eigvalsh(bound - report.stiffness)[0] > 0
    binary = homogenized(cell, resolution=24, fractions="binary")
    assert "whole" in binary.method
    assert binary.stiffness[0, 0] == pytest.approx(report.stiffness[0, 0], rel=0.1)
    assert report.solver["converged"]
    assert report.solver["wraps"] == [True] * 3
    fine = homogenized(cell, resolution=40)
    assert report.stiffness[0, 0] == pytest.approx(fine.stiffness[0, 0], rel=0.06)


def test_units_and_compliance():
    solid = voxels(np.ones((4, 4, 4), np.uint8))
    report = homogenized(solid, young=2100.0, poisson=0.25, stress_unit="MPa")
    summary = report.summary()
    assert summary["E"] == pytest.approx([2100.0] * 3, rel=1e-5)
    assert summary["G"] == pytest.approx([840.0] * 3, rel=1e-5)
    assert all(value == pytest.approx(0.25, rel=1e-5) for value in summary["nu"].values())
    assert summary["C"] == pytest.approx(from_lame(*lame(2100.0, 0.25)), rel=1e-5, abs=1e-2)
    assert summary["unit"] == "MPa"


def test_axes_of_an_image_are_x_y_z():
    """A bar along x is stiff along x."""
    values = np.zeros((4, 5, 6), np.uint8)
    values[:, 1:3, 1:4] = 1
    context = PlainContext()
    report = homogenized(voxels(values), context)
    assert tuple(report.solver["grid"]) == (4, 5, 6)
    share = 6 / 30
    assert report.summary()["E"] == pytest.approx([share, 0, 0], rel=1e-5)
    assert np.isnan(report.summary()["nu"]["yx"])
    assert report.solver["wraps"] == [True, False, False]
    assert any("no load path along yy, zz" in warning for warning in context.warnings)


def test_a_long_voxel():
    """Layers normal to x: their share counts, not the number of voxels."""
    values = np.ones((4, 3, 3), np.uint8)
    values[1] = 2
    flat = homogenized(voxels(values, spacing=(0.2, 1.0, 1.0)), young=(1.0, 0.1), poisson=(0.3, 0.2), residual=1e-6)
    cube = homogenized(voxels(values), young=(1.0, 0.1), poisson=(0.3, 0.2), residual=1e-6)
    assert pytest.approx(cube.stiffness, rel=1e-5, abs=1e-6) == flat.stiffness


def test_fractions_of_an_image_scale_the_stiffness():
    for fraction, share in ((0.2, 0.0), (0.4, 0.3), (0.5, 0.5), (0.7, 0.9), (0.8, 1.0)):
        report = homogenized(voxels(np.full((3, 3, 3), fraction, np.float32)))
        assert pytest.approx(share * from_lame(*lame(1.0, 0.3)), rel=1e-5, abs=1e-6) == report.stiffness
        assert report.porosity == pytest.approx(1 - fraction)
    binary = homogenized(voxels(np.full((3, 3, 3), 0.4, np.float32)), fractions="binary")
    assert not binary.stiffness.any()
    assert binary.solver["components"] == 0


def test_ersatz_material_fills_the_void():
    values = np.zeros((4, 4, 4), np.uint8)
    report = homogenized(voxels(values), ersatz=1e-3)
    assert pytest.approx(1e-3 * from_lame(*lame(1.0, 0.3)), rel=1e-5, abs=1e-8) == report.stiffness
    image, shares = homogenized(voxels(cross()), ersatz=0.1), voxels(cross().astype(np.float32))
    assert pytest.approx(homogenized(shares, ersatz=0.1).stiffness, rel=1e-4) == image.stiffness


def test_disconnected_solid_is_reported():
    values = np.zeros((8, 8, 8), np.uint8)
    values[2:5, 2:5, 2:5] = 1
    context = PlainContext()
    report = homogenized(voxels(values), context)
    assert not report.stiffness.any()
    assert report.summary()["E"].tolist() == [0.0, 0.0, 0.0]
    assert any("no load path along" in warning for warning in context.warnings)
    values[6:, :, 6] = 1
    report = homogenized(voxels(values), context)
    assert any("disconnected" in warning for warning in context.warnings)


def test_too_few_iterations_are_said():
    context = PlainContext()
    report = homogenized(voxels(cross()), context, iterations=1)
    assert not report.solver["converged"]
    assert "allow more `iterations`" in context.warnings[0]


def test_a_residual_replaces_the_tolerance():
    report = homogenized(voxels(cross()), residual=1e-9, precision="double")
    assert max(report.solver["residuals"]) <= 1e-9
    assert report.solver["precision"] == "float64"
    assert pytest.approx(report.stiffness, abs=1e-4 * report.stiffness.max()) == homogenized(voxels(cross())).stiffness


def test_what_is_not_periodic_is_refused(cell, ball, wang_tiling):
    with pytest.raises(DesignError, match="periodic along x, y and z"):
        homogenized(voxels(cross(), periodic=(True, True, False)))
    for field in (Part(wang_tiling, ball), wang_tiling):
        with pytest.raises(DesignError, match="periodic cell"):
            homogenized(field)


def test_phases_need_materials(cell):
    with pytest.raises(DesignError, match="phases up to 2"):
        homogenized(voxels(cross() * 2))
    with pytest.raises(DesignError, match="for 2 phases"):
        homogenized(cell, resolution=8, young=(1.0, 2.0))
    with pytest.raises(ConfigError, match="2 Young's moduli and `poisson` 3"):
        HomogenizeVoxel(young=(1.0, 2.0), poisson=(0.1, 0.2, 0.3)).check_options()


def test_a_cell_that_does_not_fit_into_memory_is_refused(cell, monkeypatch):
    monkeypatch.setattr(budget, "available_memory", lambda limit: 4_000_000)
    with pytest.raises(ResourceError, match=r"64 x 64 x 64 voxels needs .* 0\.004 GB are available"):
        homogenized(cell, resolution=64)


def test_in_a_pipeline(run_yaml, summary):
    record, _ = run_yaml(
        """
pipeline:
  - {stage: sample.mirrored_faces, count: 9, spacing: 0.2}
  - {stage: sample.dart_throwing, count: 12, spacing: 0.2}
  - {stage: connect.mbdst, degree: [2, 4], mode: greedy}
  - {stage: field.gaussian, pore_radius: 0.14, tunnel_radius: 0.05}
  - {stage: homogenize.voxel, resolution: 12, young: [70], poisson: 0.33, stress_unit: GPa}
"""
    )
    found = summary(record, "homogenize.voxel")
    assert np.array(found["C"]).shape == (6, 6)
    assert found["phases"][0]["young"] == 70.0


def test_a_broken_report_is_noticed():
    good = homogenized(voxels(cross()))
    for matrix in (np.full((6, 6), np.nan), np.zeros((3, 3)), -np.eye(6), np.eye(6) + np.eye(6, k=1)):
        with pytest.raises(ValueError, match="stiffness"):
            StiffnessReport(matrix, good.phases, "broken").check()


def test_thermal_expansion(cell):
    report = homogenized(cell, resolution=12, expansion=5e-5, solver_tolerance=0.01)
    assert report.expansion == pytest.approx([5e-5] * 3 + [0] * 3, rel=1e-4, abs=1e-8)
    assert report.summary()["expansion"] == list(report.expansion)
    layers = np.ones((2, 2, 4), np.uint8)
    layers[:, :, 2:] = 2
    values = {"young": (1.0, 2.0), "poisson": (0.3, 0.3), "expansion": (1.0e-5, 4.0e-5)}
    found = homogenized(voxels(layers), **values).expansion
    assert found[:2] == pytest.approx((1e-5 + 2 * 4e-5) / 3, rel=1e-3)
    # what is held back along the layers goes across: (1 + nu) / (1 - nu) of the mean, less 2 nu / (1 - nu) of that
    assert found[2] == pytest.approx(1.3 / 0.7 * 2.5e-5 - 0.6 / 0.7 * found[0], rel=1e-3)
    assert homogenized(voxels(layers), young=(1.0, 2.0), poisson=0.3).expansion is None
    flat = homogenized(voxels(cross()), expansion=2e-5)
    assert flat.summary()["expansion"][2] is None
    with pytest.raises(ConfigError, match="`expansion` has 1 coefficients"):
        HomogenizeVoxel(**(values | {"expansion": 1e-5})).check_options()


@dataclass(frozen=True, eq=False)
class Solid(ScalarField):
    """Layers across z, of which the lower half is solid, or a gyroid; inverted on demand."""

    gyroid: bool = False
    sign: float = 1.0

    cells = (1, 1, 1)
    periodic = True

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (2 * np.pi * grid.axis(axis) for axis in range(3))
        x, y = x[:, None, None], y[:, None]
        layers = np.abs((z + np.pi / 2) % (2 * np.pi) - np.pi) - np.pi / 2 + 0 * (x + y)
        curved = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x) - 0.4
        return (self.sign * (curved if self.gyroid else layers)).astype(np.float32)


def test_filled_layers():
    """Exact (Backus 1962)."""
    stiff, soft = (7.0, 0.2), (0.5, 0.4)
    lam, mu = np.array([lame(*stiff), lame(*soft)]).T
    across = 1 / np.mean(1 / (lam + 2 * mu))
    share = np.mean(lam / (lam + 2 * mu))
    c11 = np.mean(4 * mu * (lam + mu) / (lam + 2 * mu)) + share**2 * across
    c66, c44 = mu.mean(), 1 / np.mean(1 / mu)
    exact = np.diag([c11, c11, across, c44, c44, c66])
    exact[0, 1] = exact[1, 0] = c11 - 2 * c66
    exact[:2, 2] = exact[2, :2] = share * across
    options = {"resolution": 4, "young": stiff[0], "poisson": stiff[1], "filling_young": soft[0],
               "filling_poisson": soft[1], "residual": 1e-6}  # fmt: skip
    report = homogenized(Solid(), **options)
    assert report.stiffness == pytest.approx(exact, rel=1e-4, abs=1e-5)
    assert report.phases == (pytest.approx((0.5, *stiff)), pytest.approx((0.5, *soft)))
    assert report.porosity == 0


def test_a_filled_gyroid():
    options = {"resolution": 12, "solver_tolerance": 1e-6, "precision": "double"}
    materials = {"young": 5.0, "poisson": 0.2, "filling_young": 1.0, "filling_poisson": 0.4}
    swapped = {"young": 1.0, "poisson": 0.4, "filling_young": 5.0, "filling_poisson": 0.2}
    heat, other = ({"expansion": a, "filling_expansion": b} for a, b in ((1e-5, 6e-5), (6e-5, 1e-5)))
    report = homogenized(Solid(gyroid=True), **options, **materials, **heat)
    inverse = homogenized(Solid(gyroid=True, sign=-1.0), **options, **swapped, **other)
    assert report.stiffness == pytest.approx(inverse.stiffness, rel=1e-5, abs=1e-6)
    assert report.expansion == pytest.approx(inverse.expansion, rel=1e-5, abs=1e-10)
    bounds = report.bounds
    assert bounds.within
    assert bounds.bulk_holds  # of cubic symmetry
    # Levin 1967
    k1, k2 = (e / 3 / (1 - 2 * nu) for e, nu in ((5.0, 0.2), (1.0, 0.4)))
    k = report.stiffness[:3, :3].sum() / 9
    levin = 1e-5 + 5e-5 * (1 / k - 1 / k1) / (1 / k2 - 1 / k1)
    assert report.expansion[:3].mean() == pytest.approx(levin, rel=1e-4)
    # of the same stuff it is a block
    block = homogenized(Solid(gyroid=True), resolution=6, young=3.0, filling_young=3.0, residual=1e-6)
    assert block.stiffness == pytest.approx(from_lame(*lame(3.0, 0.3)), rel=1e-5, abs=1e-5)


def test_fillings_are_whole():
    for options, told in (
        ({"filling_young": 1.0, "ersatz": 0.1}, "`ersatz: 0.1`"),
        ({"filling_young": 1.0, "expansion": 1e-5}, "`filling_expansion` is missing"),
        ({"expansion": 1e-5, "filling_expansion": 1e-5}, "`filling_expansion` is of no use"),
    ):
        with pytest.raises(ConfigError, match=told):
            HomogenizeVoxel(**options).check_options()
    context = PlainContext()
    homogenized(voxels(cross()), context, young=(1.0, 2.0))
    assert "materials are given for 2 phases, and the image has 1" in context.warnings


def blobs(shape, share, seed=3):
    """Smooth random blobs of phase 1 that fill a share of the cell."""
    waves = np.fft.fftn(np.random.default_rng(seed).standard_normal(shape))
    squares = sum(k**2 for k in np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in shape), indexing="ij"))
    values = np.fft.ifftn(waves * np.exp(-2.4 * squares)).real
    return (values < np.quantile(values, share)).astype(np.uint8)


def mixed(phases, fractions):
    """Bounds of Voigt and Reuss, from (young, poisson)."""
    matrices = []
    for young, poisson in phases:
        lam, mu = lame(young, poisson)
        matrix = np.diag([2 * mu] * 3 + [mu] * 3)
        matrix[:3, :3] += lam
        matrices.append(matrix)
    upper = sum(f * c for f, c in zip(fractions, matrices, strict=True))
    return upper, np.linalg.inv(sum(f * np.linalg.inv(c) for f, c in zip(fractions, matrices, strict=True)))


@pytest.mark.parametrize("shape", [(9, 9, 9), (5, 8, 16)])
@pytest.mark.parametrize("filling", [1e-9, 1e-4, 0.3, 1e4])
@pytest.mark.parametrize("poisson", [-0.9, 0.49])
def test_extreme_mixtures_keep_to_the_bounds(shape, filling, poisson):
    values = blobs(shape, 0.5)
    report = homogenized(voxels(values), poisson=poisson, filling_young=filling, filling_poisson=0.1)
    c = report.stiffness
    assert report.solver["converged"]
    assert c == pytest.approx(c.T)
    share = float(values.mean())
    upper, lower = mixed(((1.0, poisson), (filling, 0.1)), (share, 1 - share))
    slack = 1e-3 * np.linalg.eigvalsh(c)[0]
    assert slack > 0
    assert np.linalg.eigvalsh(upper - c)[0] > -slack
    assert np.linalg.eigvalsh(c - lower)[0] > -slack
    # a quarter of a turn about z
    turned = homogenized(
        voxels(np.rot90(values, axes=(0, 1))), poisson=poisson, filling_young=filling, filling_poisson=0.1
    )
    order, signs = [1, 0, 2, 4, 3, 5], np.array([1, 1, 1, 1, -1, -1])
    expected = c[np.ix_(order, order)] * np.outer(signs, signs)
    assert turned.stiffness == pytest.approx(expected, abs=1e-3 * np.abs(c).max())


@pytest.mark.parametrize("share", [0.02, 0.98])
def test_hardly_any_solid_and_hardly_any_void(share):
    context = PlainContext()
    report = homogenized(voxels(blobs((12, 12, 12), share)), context)
    if share < 0.5:
        assert (report.stiffness == 0).all()
        assert any("no load path along xx, yy, zz" in text for text in context.warnings)
    else:
        assert np.linalg.eigvalsh(report.stiffness)[0] > 0.9 * lame(1, 0.3)[1]
        assert not context.warnings


def test_what_is_nearly_incompressible_is_warned_of_or_refused():
    image, context = voxels(np.ones((2, 3, 1), np.uint8)), PlainContext()
    lam, mu = lame(1, 0.499)
    assert homogenized(image, context, poisson=0.499).stiffness[0, 0] == pytest.approx(lam + 2 * mu, rel=1e-6)
    assert any("voxels lock" in text for text in context.warnings)
    homogenized(image, quiet := PlainContext(), poisson=0.49)
    homogenized(image, quiet, filling_young=0.1, filling_poisson=0.499)
    assert not quiet.warnings
    homogenized(image, fewer := PlainContext(), young=(1.0, 2.0), poisson=(0.3, 0.499))
    assert fewer.warnings == ["materials are given for 2 phases, and the image has 1"]
    for options in ({"poisson": 0.49991}, {"filling_young": 0.1, "filling_poisson": 0.4999999999}):
        with pytest.raises(ConfigError, match="voxels lock"):
            HomogenizeVoxel(**options).check_options()
    HomogenizeVoxel(filling_poisson=0.49995).check_options()


def test_grains_that_carry_nothing_have_no_stiffness(run_yaml, summary):
    """Their energies are rounding, and two ways to count them need not agree."""
    tuned = "{stage: tune.porosity, recipe: paper, target: 0.995}"
    record, _ = run_yaml(f"seed: 40\npipeline: [{tuned}, {{stage: homogenize.voxel, resolution: 16}}]\n")
    assert np.abs(summary(record, "homogenize.voxel")["E"]).max() < 1e-6
