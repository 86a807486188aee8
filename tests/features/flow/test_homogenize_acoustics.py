"""``homogenize.acoustics`` and ``write.absorption``: straight cylindrical pores, a cell of the paper, refusals."""

from dataclasses import dataclass

import numpy as np
import pytest

from sppm_pipeline.errors import DesignError
from sppm_pipeline.features.flow.acoustics import AcousticReport, air
from sppm_pipeline.features.flow.stages.homogenize_acoustics import HomogenizeAcoustics
from sppm_pipeline.features.flow.stages.write_absorption import WriteAbsorption
from sppm_pipeline.method.fields.scalar_field import ScalarField
from sppm_pipeline.nouns.length import Length
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


@dataclass(frozen=True, eq=False)
class Pore(ScalarField):
    """A straight cylindrical pore along y."""

    radius: float

    cells = (1, 1, 1)
    periodic = True

    def sample_layers(self, grid, start, stop, threads=1):
        grid = grid.layers(start, stop)
        x, z = grid.axis(0)[:, None, None] % 1 - 0.52, grid.axis(2) % 1 - 0.47
        distance = np.sqrt(x**2 + z**2) + 0 * grid.axis(1)[:, None]
        # no distance: slopes differ, as those of sums of kernels do
        return np.asarray((self.radius - distance) * (1 + x), np.float32)


class TestContract(StageContract):
    def stages(self):
        return [HomogenizeAcoustics(resolution=12, axis="y", cell=Length(1.0), solver_tolerance=0.01)]

    def inputs(self):
        return {"source": Pore(0.4)}


@pytest.fixture(scope="module")
def report():
    found = HomogenizeAcoustics(resolution=28, axis="y", cell=Length(0.5), depth=Length(2, "cm")).run(
        PlainContext(), Pore(0.4)
    )
    found.check()
    return found


def test_a_cylindrical_pore(report):
    r, porosity = 0.2, np.pi * 0.4**2  # mm, 1
    assert report.porosity == pytest.approx(porosity, rel=0.01)
    assert report.permeability == pytest.approx(porosity * (1e-3 * r) ** 2 / 8, rel=0.02)
    assert report.thermal_permeability == pytest.approx(report.permeability, rel=0.01)
    assert report.tortuosity == pytest.approx(1, rel=2e-3)
    assert report.viscous_tortuosity == pytest.approx(4 / 3, rel=0.02)
    assert report.thermal_tortuosity == pytest.approx(4 / 3, rel=0.02)
    assert report.viscous_length == pytest.approx(r, rel=0.02)
    assert report.thermal_length == pytest.approx(r, rel=0.02)
    summary = report.summary()
    assert summary["shape"] == pytest.approx(1, rel=0.05)
    assert summary["resistivity"] == pytest.approx(air(20).viscosity / report.permeability)
    assert summary["layer"] == 20
    # a layer thinner than a quarter of a wave: what a louder tone hears grows with the frequency
    assert summary["absorption"][0] < summary["absorption"][9] < summary["peak"] <= 1
    assert 1000 < summary["peak_frequency"] < 343 / 4 / 0.02 * 1.05
    assert summary["nrc"] == pytest.approx(np.mean([summary["absorption"][n] for n in (4, 7, 10, 13)]), abs=0.0251)


def test_what_is_written(report):
    context = PlainContext()
    WriteAbsorption(path="sound.svg").run(context, report)
    assert context.output("sound.svg").read_bytes().startswith(b"<?xml")
    table = np.loadtxt(context.output("sound.csv"), delimiter=",", skiprows=1)
    curve, _ = report.absorption(table[:, 0])
    assert table[:, 1] == pytest.approx(curve, abs=1e-4)
    # what is absorbed follows from the impedance
    relative = table[:, 2] + 1j * table[:, 3]
    assert 1 - abs((relative - 1) / (relative + 1)) ** 2 == pytest.approx(table[:, 1], abs=1e-4)
    lines = dict(line.split(": ") for line in context.output("sound.txt").read_text().splitlines())
    assert float(lines["viscous characteristic length"].split()[0]) == pytest.approx(200, rel=0.02)
    assert lines["layer"] == "20 mm"
    assert float(lines["absorption at 1000 Hz"]) == pytest.approx(report.bands()[1000], abs=5e-4)


def test_a_cell_of_the_paper(cell):
    found = HomogenizeAcoustics(resolution=16, cell=Length(5)).run(PlainContext(), cell)
    found.check()
    assert found.viscous_length < found.thermal_length
    assert found.permeability < found.thermal_permeability
    assert found.viscous_tortuosity > found.tortuosity > 1
    assert 0.3 < found.summary()["shape"] < 3


def test_refusals(report):
    with pytest.raises(DesignError, match="no physical size"):
        HomogenizeAcoustics(resolution=8).run(PlainContext(), Pore(0.4))
    with pytest.raises(DesignError, match="no sound passes along x"):
        HomogenizeAcoustics(resolution=8, axis="x", cell=Length(1)).run(PlainContext(), Pore(0.4))
    with pytest.raises(ValueError, match="static tortuosities"):
        AcousticReport(**{**vars(report), "viscous_tortuosity": 0.9}).check()
