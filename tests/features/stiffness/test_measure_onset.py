"""``measure.onset``: solids and laminates with known answers, bounds, units, and cells without load path."""

from itertools import pairwise

import numpy as np
import pytest

from sppm_pipeline.errors import ConfigError, DesignError
from sppm_pipeline.features.stiffness.stages.measure_onset import MeasureOnset, onsets, shares_above
from sppm_pipeline.method.nouns.voxels import Voxels
from sppm_pipeline.testing.contracts import StageContract
from sppm_pipeline.testing.plain_context import PlainContext


def voxels(values, spacing=(1.0, 1.0, 1.0)):
    return Voxels(np.asarray(values, np.uint8), spacing, False, (True,) * 3)


def measured(source, context=None, **options):
    context = context or PlainContext()
    table = MeasureOnset(**options).run(context, source)
    table.check()
    return context.reported, table.columns


class TestContract(StageContract):
    def stages(self):
        return [MeasureOnset(resolution=8, yield_stress=0.5)]

    def inputs(self):
        values = np.zeros((8, 8, 8))
        values[:, 2:6, 2:6] = 1
        return {"source": voxels(values)}


def test_a_solid_yields_all_at_once():
    numbers, table = measured(voxels(np.ones((4, 4, 4))), young=1404.0, poisson=0.45, yield_stress=29.0)
    assert numbers["onset"] == pytest.approx(29, rel=1e-5)
    assert table["axis"] == ("x",) * 3 + ("y",) * 3 + ("z",) * 3
    assert table["onset"] == pytest.approx([29] * 9, rel=1e-5)


def test_bars_yield_by_their_section():
    """A bar bears its section times its yield stress along its axis, and nothing across."""
    values = np.zeros((6, 8, 5))
    values[:, 2:5, 1:4] = 1
    context = PlainContext()
    numbers, table = measured(voxels(values, (0.5, 1.0, 2.0)), context, yield_stress=3.0)
    assert numbers["x"] == pytest.approx(3 * 9 / 40, rel=1e-4)
    assert numbers["y"] is numbers["z"] is None
    assert table["onset"][3:] == (None,) * 6
    assert "no load path along y" in " ".join(context.warnings)


def test_layers_share_the_load_by_stiffness():
    """Layers of one Poisson's ratio along x have one strain, across it one stress; the weaker yields first."""
    values = np.ones((8, 4, 4))
    values[:, :2] = 2
    given = {"young": (1.0, 3.0), "poisson": (0.0, 0.0), "yield_stress": (1.0, 2.0)}
    numbers, _ = measured(voxels(values), **given)
    # along the layers stress 1 is .5 in the soft one, 1.5 in the stiff one, which yields at 2
    assert numbers["x"] == pytest.approx(2 / 1.5, rel=1e-4)
    assert numbers["y"] == pytest.approx(1.0, rel=1e-4)  # in series the weaker one yields
    numbers, _ = measured(voxels(values), **given, yielded=0.6)
    assert numbers["x"] == pytest.approx(1 / 0.5, rel=1e-4)  # more than half: the soft one as well


def test_stresses_are_those_of_assembled_matrices(assemble):
    """Gauss point by Gauss point, by a direct solver."""
    from scipy.sparse.linalg import splu

    from sppm_pipeline.services.elastic.voigt import lame
    from tests.features.stiffness.conftest import CORNERS, isotropic, strain_matrices

    rng = np.random.default_rng(2)
    values = rng.integers(1, 3, (4, 3, 2))
    lam, mu = (np.array([lame(1.0, 0.3)[i], lame(0.2, 0.1)[i]])[values - 1] for i in (0, 1))
    matrix, forces, mean = assemble(lam.transpose(2, 1, 0), mu.transpose(2, 1, 0), (1.0, 0.5, 0.8))
    u = np.zeros_like(forces)
    u[3:] = splu(matrix[3:][:, 3:].tocsc()).solve(-forces[3:])
    stiff = (mean + forces.T @ u) / (24 * 0.4)
    strain = np.linalg.solve(stiff, np.eye(6)[1])
    u = (u @ strain).reshape(2, 3, 4, 3)
    b, _ = strain_matrices((1.0, 0.5, 0.8))
    largest = []
    for x, y, z in np.ndindex(4, 3, 2):
        own = np.array([u[(z + k) % 2, (y + j) % 3, (x + i) % 4] for i, j, k in CORNERS]).reshape(-1)
        for at in b:
            s = isotropic(lam[x, y, z], mu[x, y, z]) @ (at @ own + strain)
            dev = s[:3] - s[:3].mean()
            largest.append(np.sqrt(1.5 * (dev @ dev + 2 * s[3:] @ s[3:])))
    largest = np.sort(largest)[::-1]
    options = {"young": (1.0, 0.2), "poisson": (0.3, 0.1), "yield_stress": 1.0, "precision": "double"}
    for place in (0, 20, 100):
        numbers, _ = measured(
            voxels(values, (1.0, 0.5, 0.8)), yielded=(place + 1) / 192, solver_tolerance=1e-10, **options
        )
        assert 1 / numbers["y"] == pytest.approx(largest[place], rel=3e-4)


def test_onset_rises_with_the_share_and_stays_below_the_load_that_all_bear(cell):
    numbers, table = measured(cell, resolution=16, yield_stress=29.0, shares=(0.001, 0.01, 0.1, 0.5))
    for axis in range(3):
        rising = table["onset"][4 * axis : 4 * axis + 4]
        assert all(a < b for a, b in pairwise(rising))
    # where every part yields, the mean stress is no more than density times yield stress
    assert 0 < numbers["onset"] < numbers["relative_density"] * 29
    assert numbers["onset"] == pytest.approx(np.mean([numbers[axis] for axis in "xyz"]))
    stiffer, _ = measured(cell, resolution=16, yield_stress=29.0, young=7.0)
    assert stiffer["onset"] == pytest.approx(numbers["onset"], rel=1e-4)  # the modulus cancels
    whole, _ = measured(cell, resolution=32, yield_stress=29.0, fractions="binary")
    partial, _ = measured(cell, resolution=32, yield_stress=29.0)
    assert partial["onset"] == pytest.approx(whole["onset"], rel=0.15)
    assert partial["onset"] == pytest.approx(numbers["onset"], rel=0.15)


def test_shares_count_volume():
    ratios = np.array([[4.0] * 8, [2.0] * 8, [1.0] * 8], np.float32)
    assert onsets(ratios, np.array([0.1, 0.4, 0.5]), (0.05, 0.1, 0.11, 0.5, 1.0)) == (0.25, 0.25, 0.5, 0.5, 1.0)


def test_shares_above_multiples_of_the_mean_count_volume():
    ratios = np.array([[8.0] * 8, [1.0] * 8, [0.0] * 8], np.float32)
    # the mean is 0.1 * 8 + 0.4 * 1 = 1.2
    assert shares_above(ratios, np.array([0.1, 0.4, 0.5]), (0.0, 0.5, 2.0, 7.0)) == pytest.approx([0.5, 0.5, 0.1, 0.0])


def test_layers_concentrate_stress_and_fail_by_fatigue():
    """Along two layers of moduli 1 and 3, a quarter and three quarters: stresses are 0.4 and 1.2 of the mean one."""
    values = np.ones((8, 4, 4))
    values[:, :1] = 2
    given = {"young": (3.0, 1.0), "poisson": (0.0, 0.0), "yield_stress": 2.0, "shares": (0.5, 1.0)}
    numbers, table = measured(voxels(values), **given, basquin=(1.5, -0.1), cycles=(1e2, 1e6))
    assert table["concentration"][:2] == pytest.approx((1.2, 0.4), rel=1e-4)
    assert numbers["above"] == [0.0] * 3
    assert numbers["fatigue"][0] == pytest.approx(numbers["onset"] * 1.5 * 200**-0.1, rel=1e-6)
    assert numbers["fatigue"][1] == pytest.approx(numbers["onset"] * 1.5 * 2e6**-0.1, rel=1e-6)
    numbers, _ = measured(voxels(values), **given, basquin=(1.5, -0.1), cycles=(1.0, 1e6))
    assert numbers["fatigue"][0] is None  # 1.4 times the yield stress: the solid yields in the first cycle
    two, table = measured(voxels(values), **(given | {"yield_stress": (2.0, 1.0)}))
    assert "concentration" not in table
    assert "fatigue" not in two


def test_refusals():
    with pytest.raises(ConfigError, match="`basquin` is"):
        MeasureOnset(basquin=(1.5, 0.1)).check_options()
    with pytest.raises(DesignError, match="empty"):
        measured(voxels(np.zeros((3, 3, 3))))
    with pytest.raises(ConfigError, match="`yield_stress` has 3 values, and `young` 2"):
        MeasureOnset(young=(1.0, 2.0), yield_stress=(1.0,) * 3).check_options()
