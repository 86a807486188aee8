"""Reports of stiffness: what they say of known materials."""

import json

import numpy as np
import pytest

from sppm_pipeline.engine.strict_json import json_text, jsonable
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.elastic.voigt import isotropic
from tests.conftest import cubic

SOLID = ((1.0, 2.0, 0.3),)
POROUS = ((0.4, 1.0, 0.3), (0.6, 0.0, 0.0))


def test_a_solid_cell():
    report = StiffnessReport(isotropic(2.0, 0.3), SOLID, "exact", unit="GPa")
    report.check()
    found = report.summary()
    assert found["porosity"] == 0
    assert found["E"] == pytest.approx([2.0] * 3)
    assert [found[name] for name in ("E_relative", "E_x_relative", "E_ratio")] == pytest.approx([1.0] * 3)
    assert found["nu"]["xy"] == pytest.approx(0.3)
    assert found["isotropic"] == pytest.approx({"E": 2.0, "nu": 0.3})
    assert found["xi"] == pytest.approx(0, abs=1e-12)
    assert found["zener"] == pytest.approx(1)
    assert found["E_min"]["value"] == pytest.approx(found["E_max"]["value"])
    assert found["bounds"]["within_voigt_and_reuss"]
    assert found["bounds"]["bulk_within"]
    assert "error" not in found


def test_no_stiffness_is_no_nonsense():
    report = StiffnessReport(np.zeros((6, 6)), POROUS, "voxels")
    report.check()
    found = json.loads(json_text(jsonable(report.summary())))
    assert found["E"] == [0, 0, 0]
    assert found["nu"]["xy"] is None
    assert found["universal_anisotropy"] is None
    assert found["bounds"]["within_voigt_and_reuss"]
    assert report.porosity == 0.6


def test_an_error_bar_is_told_relative_too():
    report = StiffnessReport(isotropic(1.0, 0.0), SOLID, "voxels", error=0.01 * isotropic(1.0, 0.0))
    assert report.summary()["error_relative"] == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("stiffness", "phases"),
    [
        (np.zeros((3, 3)), SOLID),
        (np.full((6, 6), np.nan), SOLID),
        (np.diag([1, 1, 1, 1, 1, np.inf]), SOLID),
        (np.diag([1, 1, 1, 1, 1, -1e-3]), SOLID),
        (np.triu(np.ones((6, 6))), SOLID),
        (np.eye(6), ((0.5, 1.0, 0.3),)),
    ],
)
def test_contradictions_are_refused(stiffness, phases):
    with pytest.raises(ValueError):
        StiffnessReport(stiffness, phases, "x").check()


def test_poissons_ratios_of_a_material_that_is_not_the_same_along_all_axes():
    """nu_xy is the contraction along y when pulled along x: nu_xy / E_x = nu_yx / E_y, with different E_x and E_y."""
    flexibility = np.diag([1 / 10, 1 / 4, 1 / 2, 1.0, 1.0, 1.0])
    flexibility[0, 1] = flexibility[1, 0] = -0.3 / 10
    flexibility[0, 2] = flexibility[2, 0] = -0.2 / 10
    flexibility[1, 2] = flexibility[2, 1] = -0.1 / 4
    found = StiffnessReport(np.linalg.inv(flexibility), ((1.0, 20.0, 0.3),), "exact").summary()
    assert found["E"] == pytest.approx([10, 4, 2])
    # the relative modulus has no direction: the one along x stands beside it, and the range over all directions
    assert found["E_relative"] == pytest.approx(found["isotropic"]["E"] / 20)
    assert found["E_x_relative"] == pytest.approx(10 / 20)
    assert found["E_ratio"] == pytest.approx(found["E_max"]["value"] / found["E_min"]["value"])
    assert found["E_ratio"] > 5
    expected = {"xy": 0.3, "xz": 0.2, "yz": 0.1, "yx": 0.3 * 4 / 10, "zx": 0.2 * 2 / 10, "zy": 0.1 * 2 / 4}
    assert found["nu"] == pytest.approx(expected)


def test_error_bars_of_moduli_follow_those_of_the_matrix():
    report = StiffnessReport(isotropic(2.0, 0.3), SOLID, "voxels", error=0.01 * isotropic(2.0, 0.3))
    assert report.summary()["E_error"] == pytest.approx([0.02] * 3)
    assert report.summary()["E_relative_error"] == pytest.approx(0.01)
    assert report.summary()["G_error"] == pytest.approx([0.01 * 2 / 2.6] * 3)


def test_error_bars_of_moduli_take_all_entries_as_too_stiff():
    """Of a cubic material E = (a - b) (a + 2 b) / (a + b)."""
    report = StiffnessReport(cubic(5.0, 2.0, 1.0), SOLID, "voxels", error=cubic(0.5, 0.1, 0.2))
    young, softer = 3 * 9 / 7, 2.6 * 8.3 / 6.4
    assert report.summary()["E"] == pytest.approx([young] * 3)
    assert report.summary()["E_error"] == pytest.approx([young - softer] * 3)
    assert report.summary()["G_error"] == pytest.approx([0.2] * 3)
    assert "error_relative" not in StiffnessReport(cubic(5.0, 2.0, 1.0), SOLID, "voxels").summary()


def test_a_report_keeps_what_it_was_given():
    given = np.diag([1, 1, 0, 1, 0, 0])  # a structure that gives way contradicts nothing
    report = StiffnessReport(given, [[1, 2, 0.5]], "x", error=given)
    report.check()
    given[:] = 7
    assert report.stiffness[0, 0] == report.error[0, 0] == 1
    assert report.stiffness.dtype == report.error.dtype == np.float64
    assert not report.stiffness.flags.writeable
    assert not report.error.flags.writeable
    assert report.phases == ((1.0, 2.0, 0.5),)
    assert report.base == 2.0


def test_what_rounding_leaves_of_a_solid_that_carries_nothing_is_no_contradiction():
    left = np.diag([1.7e-10, 1e-11, 4e-12, 1e-12, 0.0, -1.4e-11])
    left[0, 1] = 3e-12
    report = StiffnessReport(left, POROUS, "voxels")
    report.check()
    assert report.summary()["E_relative"] == pytest.approx(0, abs=1e-9)
    with pytest.raises(ValueError, match="no negative energy"):
        StiffnessReport(np.diag([1.7e-3, 0, 0, 0, 0, -1e-6]), POROUS, "voxels").check()
