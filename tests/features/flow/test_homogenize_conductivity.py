"""``homogenize.conductivity``: solid and void, tortuosity, refusals."""

import functools
from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.flow.permeability import ConductivityReport
from sppm_pipeline.features.flow.stages.homogenize_conductivity import HomogenizeConductivity
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


def voxels(values, periodic=(True, True, True)):
    return Voxels(np.asarray(values), (1.0, 1.0, 1.0), False, periodic)


def bar():
    """Along x."""
    values = np.zeros((6, 5, 4), np.uint8)
    values[:, 1:3, 1:4] = 1
    return values


def conducted(source, context=None, **options):
    report = HomogenizeConductivity(**options).run(context or PlainContext(), source)
    report.check()
    return report


class TestContract(StageContract):
    def stages(self):
        return [HomogenizeConductivity(resolution=8), HomogenizeConductivity(resolution=8, of="void")]

    def inputs(self):
        return {"source": voxels(bar())}


def test_a_bar_conducts_along_its_axis():
    context = PlainContext()
    report = conducted(voxels(bar()), context, bulk=200.0)
    assert report.k == pytest.approx(np.diag([200 * 6 / 20, 0, 0]), rel=1e-5)
    assert report.tortuosity == (pytest.approx(1, rel=1e-5), None, None)
    assert report.wraps == (True, False, False)
    assert any("no flow along y, z" in warning for warning in context.warnings)


def test_the_void_around_it():
    report = conducted(voxels(bar()), of="void")
    assert report.k[0, 0] == pytest.approx(14 / 20, rel=1e-5)
    assert report.tortuosity[0] == pytest.approx(1, rel=1e-5)
    assert report.tortuosity[1] > 1
    assert report.porosity == pytest.approx(14 / 20)


def test_a_scan_without_periodic_faces_is_named_and_mirrored(blobs):
    context = PlainContext()
    conducted(voxels(blobs), context)
    assert any("opposite faces of the image do not fit along x" in text for text in context.warnings)
    context = PlainContext()
    mirrored = conducted(voxels(blobs).mirrored(), context, residual=1e-5)
    assert not any("opposite faces" in text for text in context.warnings)
    assert mirrored.k == pytest.approx(np.diag(np.diag(mirrored.k)), abs=1e-4 * mirrored.k.max())
    # without a word, an array would be taken for a cell
    with pytest.raises(DesignError, match="periodic"):
        conducted(Voxels.from_array(blobs))


def test_phases_of_the_solid():
    values = np.ones((4, 3, 3), np.uint8)
    values[2:] = 2
    report = conducted(voxels(values), bulk=(1.0, 3.0), residual=1e-6)
    assert report.k == pytest.approx(np.diag([1.5, 2.0, 2.0]), rel=1e-5, abs=1e-5)


def test_gas_and_solid_together(cell):
    values = np.ones((4, 3, 3), np.uint8)
    values[1:2] = 2
    values[2:] = 0
    report = conducted(voxels(values), of="both", bulk=(1.0, 4.0), fluid=0.1, residual=1e-6)
    along, across = (1 + 4 + 2 * 0.1) / 4, 4 / (1 + 1 / 4 + 2 / 0.1)
    assert report.k == pytest.approx(np.diag([across, along, along]), rel=1e-5, abs=1e-5)
    assert report.summary()["fluid"] == 0.1
    # between the bounds of Hashin and Shtrikman, on average over the axes, and above the solid alone
    report, alone = (conducted(cell, resolution=16, bulk=5.0, **more) for more in ({"of": "both", "fluid": 0.5}, {}))
    phi = report.porosity
    low = 0.5 + (1 - phi) / (1 / 4.5 + phi / 1.5)
    high = 5 - phi / (1 / 4.5 - (1 - phi) / 15)
    assert low < np.trace(report.k) / 3 < high
    assert np.linalg.eigvalsh(report.k - alone.k)[0] > 0
    uniform = conducted(cell, resolution=8, of="both", bulk=2.0, fluid=2.0)
    assert uniform.k == pytest.approx(2 * np.eye(3), rel=1e-5, abs=1e-5)
    for options in ({"of": "both"}, {"fluid": 1.0}):
        with pytest.raises(ConfigError, match="`fluid`"):
            HomogenizeConductivity(**options).check_options()


@pytest.mark.parametrize("of", ["solid", "void"])
def test_a_cell_of_the_paper(cell, of):
    report = conducted(cell, resolution=24, of=of)
    assert report.fractions
    share = report.porosity if of == "void" else 1 - report.porosity
    # the upper bound of Hashin and Shtrikman for a conductor in an insulator, on average over the axes
    assert 0 < np.trace(report.k) / 3 < 2 * share / (3 - share)
    assert all(value > 1 for value in report.tortuosity)


@pytest.mark.parametrize("more", [{"of": "solid"}, {"of": "void"}, {"of": "both", "bulk": 1.0, "fluid": 0.05}])
def test_the_limit_of_two_grids_is_better_than_the_finer_and_within_its_error_bar(cell, more):
    exact = np.trace(conducted(cell, resolution=72, **more).k)
    alone = np.trace(conducted(cell, resolution=32, grids=1, **more).k)
    limit = conducted(cell, resolution=32, **more)
    assert np.trace(limit.k) == pytest.approx(exact, rel=0.03)
    assert abs(np.trace(limit.k) - exact) < np.trace(limit.error)
    assert more["of"] == "both" or abs(np.trace(limit.k) - exact) < 0.5 * abs(alone - exact)
    summary = limit.summary()
    assert np.shape(summary["error"]) == (3, 3)
    binary = conducted(cell, resolution=32, fractions="binary", **more)
    assert binary.k == pytest.approx(conducted(cell, resolution=32, fractions="binary", grids=1, **more).k, rel=1e-6)
    assert abs(np.trace(binary.k) - exact) < np.trace(binary.error)


@dataclass(frozen=True, eq=False)
class Wall(ScalarField):
    """A wall across a diagonal, or across x, or closed ones around the cell, which let nothing through."""

    thickness: float
    diagonal: bool = False
    stated: bool = False
    closed: bool = False

    cells = (1, 1, 1)
    periodic = True

    @property
    def thinnest_wall(self):
        return self.thickness if self.stated else None

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, y, z = (grid.axis(axis) for axis in range(3))
        across = (x[:, None, None] + self.diagonal * y[:, None] + 0.31 + 0 * z) % 1 - 0.5
        if self.closed:
            sides = (np.abs((axis + 0.31) % 1 - 0.5) for axis in (x[:, None, None], y[:, None], z))
            return (functools.reduce(np.minimum, sides) - self.thickness / 2).astype(np.float32)
        return (np.abs(across) / np.sqrt(1 + self.diagonal) - self.thickness / 2).astype(np.float32)


def through(field, **options):
    """Conductivity across the wall, and warnings."""
    context = PlainContext()
    report = conducted(field, context, resolution=16, of="void", **options)
    return np.linalg.eigvalsh(report.k)[0], [text for text in context.warnings if "wall" in text]


def test_walls_too_thin_for_the_voxels_are_told():
    for voxels_across, leaks in ((1.5, True), (2.5, True), (3, False), (4, False)):
        k, warnings = through(Wall(voxels_across / 16, True, stated=True))
        assert (k > 0.03) == leaks
        assert bool([text for text in warnings if f"{voxels_across} voxels thick" in text]) == leaks
        assert (k < 1e-4) != leaks
    assert any("`resolution: 30`" in text for text in through(Wall(0.1001, True, stated=True))[1])
    # where nothing flows nothing leaks
    assert through(Wall(2.2 / 16, stated=True, closed=True)) == (0, [])
    assert through(Wall(1.5 / 16, stated=True, closed=True))[1]


def test_flow_through_voxels_that_are_mostly_solid_is_told():
    k, warnings = through(Wall(1.5 / 16))
    assert k > 0.5
    assert len(warnings) == 1
    assert "the flow along x passes only through voxels" in warnings[0]
    assert "`resolution: 32`" in warnings[0]
    assert through(Wall(0.2 / 16)) == (pytest.approx(0.98, abs=0.03), [])
    assert through(Wall(3 / 16))[1] == []
    assert through(Wall(1.5 / 16), bulk=50.0)[1] == warnings
    assert through(Wall(1.5 / 16), fractions="binary")[1] == []


def test_refusals(cell, wang_tiling):
    with pytest.raises(DesignError, match="periodic"):
        conducted(voxels(bar(), periodic=(True, False, True)))
    with pytest.raises(DesignError, match="periodic"):
        conducted(wang_tiling)
    with pytest.raises(DesignError, match="phases up to 3"):
        conducted(voxels(3 * bar()))
    with pytest.raises(DesignError, match="for 2 phases"):
        conducted(cell, resolution=8, bulk=(1.0, 2.0))
    with pytest.raises(ConfigError, match="2 conductivities for the void"):
        HomogenizeConductivity(of="void", bulk=(1.0, 2.0)).check_options()


def test_a_broken_report_is_noticed():
    good = conducted(voxels(bar()))
    for matrix in (np.full((3, 3), np.nan), np.zeros((2, 2)), -np.eye(3), np.eye(3) + np.eye(3, k=1)):
        with pytest.raises(ValueError, match="conductivity"):
            ConductivityReport(**{**vars(good), "k": matrix}).check()
