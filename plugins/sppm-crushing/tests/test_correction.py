"""Compliance, preload and toe: what is put on a curve is taken off again."""

import numpy as np
import pytest
from sppm_crushing.numerics.compression import Specimen, measures
from sppm_crushing.stages.read_compression import after_preload, blank_run, without_blank, without_toe

AREA, HEIGHT = 2025.0, 45.0
STRAIN = np.arange(6001) / 10000
STRESS = np.interp(STRAIN, [0, 0.03, 0.05, 0.1, 0.25, 0.5, 0.6], [0, 3.0, 2.5, 2.0, 2.0, 2.2, 4.0])


def numbers(strain, stress):
    return {m.name: m.value for m in measures(strain, stress, Specimen("MPa", AREA, HEIGHT, 0.4))}


def test_a_curve_comes_back_from_compliance_toe_and_preload():
    force, way = STRESS * AREA, STRAIN * HEIGHT
    # the plates come in 2 mm above the specimen and settle over 0.3 mm, along a parabola that joins the first rise
    slope, settling = force[1] / way[1], 0.3
    toe = np.linspace(0, 2 * settling, 100)
    settled = way > settling
    way = np.concatenate([toe, way[settled] + settling]) + 2
    force = np.concatenate([slope / 4 / settling * toe**2, force[settled]])
    way = np.concatenate([np.linspace(0, 1.99, 50), way])
    force = np.concatenate([np.zeros(50), force])
    machine = lambda f: 0.3 * (f / 8000) ** 0.7 + f / 40000  # noqa: E731 - mm at N
    blank = blank_run(np.linspace(0, 9000, 500), machine(np.linspace(0, 9000, 500)) + 7)
    found_way = without_blank(force, way + machine(force), blank)
    assert found_way == pytest.approx(way, abs=2e-3)
    found_force, found_way = after_preload(force, found_way, 1.0)
    assert found_force[0] >= 1
    assert found_way[0] == 0
    strain, stress, line = without_toe(found_way / HEIGHT, found_force / AREA)
    assert line.slope == pytest.approx(100, rel=2e-3)
    before, after = numbers(STRAIN, STRESS), numbers(strain, stress)
    for name, value in before.items():
        if value is None or name == "plateau_end":
            continue
        assert after[name] == pytest.approx(value, rel=5e-3), name
    uncorrected = numbers((way + machine(force)) / HEIGHT, force / AREA)
    assert uncorrected["gradient"] < 0.9 * before["gradient"]


def test_a_blank_run_with_noise_and_unloading_never_falls():
    rng = np.random.default_rng(3)
    force = np.concatenate([np.linspace(0, 100, 400), np.linspace(100, 0, 400)])
    blank = blank_run(force, force / 1000 + rng.normal(0, 5e-4, 800))
    assert (np.diff(blank.displacement) >= 0).all()
    assert np.interp(50, blank.force, blank.displacement) == pytest.approx(0.05, abs=1.5e-3)


def test_what_a_correction_can_not_do_is_said():
    blank = blank_run([0, 10, 20], [0, 1, 2])
    with pytest.raises(ValueError, match="ends at 20 N, and the test goes to 21 N"):
        without_blank([0, 21], [0, 1], blank)
    with pytest.raises(ValueError, match="two or more"):
        blank_run([5, 5], [0, 1])
    with pytest.raises(ValueError, match="before the preload of 30 N"):
        after_preload([0, 21], [0, 1], 30)
    with pytest.raises(ValueError, match="does not rise"):
        without_toe(np.linspace(0, 0.5, 100), np.ones(100))
