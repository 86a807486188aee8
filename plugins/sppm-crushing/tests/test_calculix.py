"""The same voxels in CalculiX, an independent implicit code."""

import shutil

import numpy as np
import pytest
from sppm_crushing.numerics.body import body_of

CURVE = """
0.0050 4.068004e-04 3.874845e-04
0.0100 8.058020e-04 7.653160e-04
0.0150 1.188431e-03 1.123586e-03
0.0200 1.537368e-03 1.438625e-03
0.0300 1.964507e-03 1.797068e-03
0.0500 2.256625e-03 2.015021e-03
0.1000 2.333903e-03 2.010411e-03
0.1250 2.313236e-03 1.961651e-03
0.1500 2.291846e-03 1.914885e-03
0.1750 2.271809e-03 1.871983e-03
0.2000 2.253319e-03 1.833341e-03
0.2200 2.240411e-03 1.805788e-03
0.2400 2.229548e-03 1.780977e-03
"""
"""Strain, and stress by CalculiX 2.20 with C3D8 and with C3D8I, of the gyroid cell of 16 voxels:
`python -m benchmarks.calculix curve`. The first is integrated fully and too stiff where it flows, the second has
incompatible modes. From 15 % on, walls touch each other, which those runs know nothing of."""

STRAIN, FULL, SOFT = np.array([line.split() for line in CURVE.split("\n") if line], float).T


@pytest.fixture
def calculix():
    """What drives CalculiX is a benchmark of the repository, which this folder alone has not."""
    return pytest.importorskip("benchmarks.calculix")


def ratios(march, strains):
    """Our stress over that of C3D8."""
    history = march.history()
    return np.interp(STRAIN[strains], history.strain, (history.top + history.bottom) / 512) / FULL[strains]


def test_modulus_is_that_of_calculix(crushed):
    assert ratios(crushed, (STRAIN > 0.007) & (STRAIN < 0.02)).mean() == pytest.approx(1, abs=0.015)


def test_without_contact_the_curve_is_that_of_calculix(untouched):
    late = STRAIN >= 0.03
    assert ratios(untouched, late) == pytest.approx(1, abs=0.065)
    assert (ratios(untouched, late) > SOFT[late] / FULL[late]).all()


def test_contact_makes_the_rest(crushed, untouched):
    early, late = (STRAIN >= 0.03) & (STRAIN < 0.14), STRAIN >= 0.2
    assert ratios(crushed, early) == pytest.approx(ratios(untouched, early), abs=1e-9)
    assert (ratios(crushed, late) > 1.1 * ratios(untouched, late)).all()


needs_calculix = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")


@needs_calculix
def test_a_fresh_run_repeats_the_beginning_of_the_curve(calculix, cell, tmp_path):
    begun = STRAIN <= 0.015  # some voxels flow
    found = calculix.curve(body_of(cell), "C3D8", tmp_path, STRAIN[begun], to=0.015)
    assert found == pytest.approx(FULL[begun], rel=1e-4)


@needs_calculix
def test_our_material_integrated_fully_is_c3d8(calculix, tmp_path):
    """So that what is between the curves is the element's way to bend, and not the material."""
    full = {}
    for name in ("uniform, 10 %", "bent by .05", "uniform, and bent both ways by .1"):
        path = calculix.PATHS[name]
        full[name] = calculix.work_in_calculix("C3D8", tmp_path, path, 10)
        assert calculix.work(calculix.whole_brick(), path, 10) == pytest.approx(full[name], rel=0.01)
    path = calculix.PATHS["bent by .05"]
    soft = calculix.work_in_calculix("C3D8I", tmp_path, path, 10)
    assert 1.3 * soft < calculix.work(calculix.our_brick(), path, 10) < 0.75 * full["bent by .05"]


def test_a_brick_in_uniform_strain_is_its_material(calculix):
    path = calculix.PATHS["uniform, 10 %"]
    found = [calculix.work(brick(), path, 20) for brick in (calculix.our_brick, calculix.whole_brick)]
    assert found[0] == pytest.approx(found[1], rel=1e-12)
