"""``homogenize.permeability``: fields and images, units, pockets, error bars, the picture."""

from dataclasses import dataclass

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.permeability import DARCY, PermeabilityReport
from sppm_pipeline.features.flow.stages.homogenize_permeability import HomogenizePermeability
from sppm_pipeline.features.flow.stages.write_flow import WriteFlow
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.nouns import FormulaField
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


def voxels(values, spacing=(1.0, 1.0, 1.0), physical=False, periodic=(True, True, True)):
    return Voxels(np.asarray(values), spacing, physical, periodic)


def solved(source, context=None, **options):
    report = HomogenizePermeability(**options).run(context or PlainContext(), source)
    report.check()
    return report


def slit():
    """A slit of six voxels across z in a cell of 4 x 5 x 8, and a void of one voxel that is closed off."""
    values = np.ones((4, 5, 8), np.uint8)
    values[:, :, :6] = 0
    return values


class TestContract(StageContract):
    def stages(self):
        return [HomogenizePermeability(resolution=8)]

    def inputs(self):
        return {"source": voxels(slit())}


def test_a_slit_in_an_image():
    exact = 6**3 / 12 / 8 * (1 + 1 / (3 * 6**3))  # in voxels, of the discrete equations
    context = PlainContext()
    report = solved(voxels(slit(), (0.5, 0.5, 0.5), physical=True), context)
    assert report.k * 8**2 == pytest.approx(np.diag([exact, exact, 0]), rel=1e-4, abs=1e-6)
    assert report.edge_mm == 4
    assert report.m2 == pytest.approx(report.k * 16e-6)
    summary = report.summary()
    assert summary["darcy"][0][0] == pytest.approx(exact * 0.25e-6 / DARCY, rel=1e-5)
    assert summary["kozeny"] is None
    assert report.wraps == (True, True, False)
    assert report.hydraulic_tortuosity[0] == pytest.approx(1, rel=1e-4)
    assert report.hydraulic_tortuosity[2] is None
    assert any("nothing flows along z" in text for text in context.warnings)
    # half a solid layer more: as fractions, the wall moves by half a voxel
    values = slit().astype(np.float32)
    values[:, :, 6] = 0.5
    assert solved(voxels(values)).k[0, 0] == pytest.approx(6.5**3 / 12 / 8, rel=0.005)
    assert solved(voxels(values), fractions="binary").k[0, 0] == pytest.approx(exact, rel=1e-4)


def test_pockets_and_sizes():
    values = slit()
    values[1:3, 1:3, 6:7] = 1
    values[2, 2:4, 7] = 1
    values = np.concatenate([values, np.ones((4, 5, 4), np.uint8)], axis=2)
    values[1:3, 1:3, 9:11] = 0
    context = PlainContext()
    report = solved(voxels(values), context, cell=Length(0.2, "in"))
    assert any("1 closed pockets" in text for text in context.warnings)
    assert report.edge_mm == pytest.approx(5.08)
    assert 0 < report.pocket_share < 0.1
    assert report.porosity == pytest.approx((1 - report.pocket_share) * (values == 0).mean())
    assert report.k[0, 0] == pytest.approx(6**3 / 12 / 12, rel=0.08)  # the edge of a voxel is a cell edge here
    closed = solved(voxels(np.ones((4, 4, 4), np.uint8)), PlainContext())
    assert (closed.k == 0).all()
    assert closed.summary()["thermal_tortuosity"] is None


def test_a_cell_of_the_paper(cell, tmp_path):
    context = PlainContext()
    report = solved(cell, context, resolution=24, grids=2, cell=Length(5))
    finer = solved(cell, resolution=36)
    assert report.error[0, 0] > abs(report.k[0, 0] - finer.k[0, 0])
    assert report.summary()["error_relative"] < 0.5
    assert report.edge_mm == 5
    assert report.m2[1, 1] == pytest.approx(report.k[1, 1] * 25e-6)
    assert finer.m2 is None
    assert "k_m2" not in finer.summary()
    assert max(report.iterations) <= 35
    # Kozeny's constant is near 5 for packed beds, and more where pores are connected by throats
    assert 3 < report.kozeny < 30
    assert report.kozeny == pytest.approx(report.porosity**3 / (np.trace(report.k) / 3 * report.surface**2))
    values = np.linalg.eigvalsh(report.k)
    assert values[0] > 0
    assert values[2] < report.thermal
    images = np.asarray(cell.sample(24) < 0).astype(np.uint8)
    image = solved(voxels(images, (1 / 24,) * 3))
    assert image.k == pytest.approx(report.k, rel=0.25, abs=0.25 * report.k[0, 0])
    assert solved(cell, resolution=24, fractions="binary").k == pytest.approx(image.k, rel=1e-3)
    WriteFlow(path="flow.png", axis="y", image_size=(400, 300)).run(context, report)
    picture = np.asarray(Image.open(context.output("flow.png")).convert("RGB"))
    assert picture.shape == (300, 400, 3)
    solid = np.isnan(report.slices[1])
    white = (picture[:, :260] == 255).all(axis=2)[:, 0:260]
    # y to the right, z up, the square of 300 pixels cut to 260 by the scale of colors
    square = white[20:280, :260]
    expected = np.kron(solid[::-1], np.ones((11, 11), bool))
    assert square[5:-5, 5:-5].mean() == pytest.approx(expected.mean(), abs=0.05)


def test_the_limit_of_two_grids_is_the_result_for_a_field(cell):
    """Much nearer to that of fine grids than either grid, and covered by its error bar."""
    truth = solved(cell, resolution=64).k_mean
    context = PlainContext()
    report = solved(cell, context, resolution=24)
    coarse, fine = (solved(cell, resolution=n, grids=1) for n in (16, 24))
    assert report.k == pytest.approx(fine.k + (fine.k - coarse.k) / (1.5**2.25 - 1), rel=1e-6)
    assert report.error == pytest.approx(np.abs(report.k - fine.k), rel=1e-6)
    assert abs(report.k_mean - truth) < np.trace(report.error) / 3
    assert abs(report.k_mean - truth) < 0.4 * abs(fine.k_mean - truth)
    assert report.thermal == fine.thermal
    assert context.reported["convergence"]["resolutions"] == [16, 24]
    assert ("the error bar is" in " ".join(report.warnings)) == (report.error_relative > 0.1)
    assert fine.error is None
    assert solved(cell, resolution=24, fractions="binary").error is None


def test_throats_that_the_coarser_grid_closes_are_named():
    """Nothing is extrapolated there, and what needs a finer grid is said."""

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Pipe(FormulaField):
        radius: float

        def evaluate(self, x, y, z):
            return self.radius - np.hypot(y - 0.5, z - 0.5) + 0 * x

    pipe, context = Pipe(radius=0.03), PlainContext()
    report = solved(pipe, context, resolution=24)
    one = solved(pipe, resolution=24, grids=1)
    assert report.k == pytest.approx(one.k)
    assert report.error_relative > 0.5
    assert any("raise `resolution` to about" in text for text in context.warnings)
    wide, context = Pipe(radius=0.3), PlainContext()
    report = solved(wide, context, resolution=24)
    assert report.k[0, 0] == pytest.approx(np.pi * 0.3**4 / 8, rel=0.01)
    assert report.k[1, 1] == report.error[1, 1] == 0
    assert not any("error bar" in text for text in context.warnings)


def test_solid_that_the_coarser_grid_misses_is_named():
    """The ball holds one face of the grid across each axis, and none of the coarser one."""

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Ball(FormulaField):
        def evaluate(self, x, y, z):
            center = 12 / 24 + 1 / 72
            return np.sqrt((x - center) ** 2 + (y - center) ** 2 + (z - center) ** 2) - 0.022

    context = PlainContext()
    report = solved(Ball(), context, resolution=24)
    assert report.k == pytest.approx(solved(Ball(), resolution=24, grids=1).k)
    assert report.error is None
    assert "convergence" not in context.reported
    (said,) = report.warnings
    assert said in context.warnings
    assert "no error bar, as 16 voxels along an edge miss all walls" in said
    assert "resolution: 48" in said
    with pytest.raises(DesignError, match="permeability is infinite"):  # who asks for two grids gets two
        solved(Ball(), resolution=24, grids=2)


def test_an_image_has_an_error_bar_that_covers_finer_voxels(flow, gyroid):
    def image(n):
        x = (np.arange(n) + 0.5) / n
        return voxels(gyroid(x[:, None, None], x[:, None], x) < 0, (1 / n,) * 3)

    context = PlainContext()
    report = solved(image(24), context, grids=2)
    fine = solved(image(48)).k
    assert (np.abs(report.k - fine) <= report.error + 1e-4 * fine[0, 0]).all()
    assert report.error_relative < 0.5
    assert context.reported["convergence"]["resolutions"] == [12, 24]


@pytest.mark.parametrize(("width", "warned"), [(4, True), (5, False)])
def test_throats_of_few_whole_voxels_are_named(width, warned):
    values = np.ones((12, 12, 12), np.uint8)
    values[:, 1:9, 1:9] = 0
    values[5:7] = 1
    values[5:7, 2 : 2 + width, 2 : 2 + width] = 0
    context = PlainContext()
    solved(voxels(values), context, solver_tolerance=0.01)
    assert any("along x has throats of less than 5 voxels" in text for text in context.warnings) == warned
    context = PlainContext()
    solved(voxels(values.astype(np.float32)), context, solver_tolerance=0.01)
    assert not any("throats" in text for text in context.warnings)


def test_an_image_that_is_no_cell_is_named(blobs):
    context = PlainContext()
    solved(voxels(blobs), context)
    assert any("opposite faces of the image do not fit along x" in text for text in context.warnings)
    context = PlainContext()
    solved(voxels(blobs).mirrored(), context)
    assert not any("opposite faces" in text for text in context.warnings)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("shape", [(1, 1, 8), (7, 20, 9), (33, 3, 8)])
def test_slits_in_cells_of_any_shape(shape, axis):
    values = np.ones(shape, np.uint8)
    values[..., 1:7] = 0
    turned = np.moveaxis(values, 2, axis)
    spacing = tuple(np.insert([2.0, 3.0], axis, 1.0).tolist())
    k = solved(voxels(turned, spacing), solver_tolerance=1e-5).k
    exact = 6**3 / 12 / shape[2] * (1 + 1 / (3 * 6**3))
    assert np.diag(k)[axis] == 0
    assert np.delete(np.diag(k), axis) == pytest.approx([exact] * 2, rel=1e-4)


def test_refusals():
    with pytest.raises(ConfigError, match="4 x 5 x 8 voxels has no coarser one"):
        solved(voxels(slit()), grids=2)
    with pytest.raises(ConfigError, match="no coarser grids"):
        HomogenizePermeability(resolution=2, grids=3).run(PlainContext(), voxels(slit()))
    with pytest.raises(DesignError, match="periodic"):
        solved(voxels(slit(), periodic=(True, False, True)))
    for shape in ((1, 1, 7), (4, 5, 6)):
        with pytest.raises(DesignError, match="permeability is infinite"):
            solved(voxels(np.zeros(shape, np.uint8)))
    # a plate of .9 voxels lies between the faces across it
    plate = np.zeros((5, 4, 6), np.float32)
    plate[:, 2] = 0.9
    with pytest.raises(DesignError, match="misses all solid along y, so"):
        solved(voxels(plate))
    plate[:, 2] = 1
    assert solved(voxels(plate)).k[1, 1] == 0
    report = solved(voxels(slit()))
    skew = PermeabilityReport(**{**vars(report), "k": report.k + np.eye(3)[[1, 0, 2]] * [1, 0, 0]})
    with pytest.raises(ValueError, match="symmetric"):
        skew.check()
