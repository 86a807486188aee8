"""Measures of compression: curves whose numbers are known, curves that lack them, and bounds."""

import numpy as np
import pytest
from sppm_crushing.crusher import PLATEAU, mean_stress
from sppm_crushing.numerics.compression import (
    Specimen,
    loading,
    loading_branch,
    mean_and_spread,
    measures,
    work_ratio,
)

SPECIMEN = Specimen("MPa", area=2025.0, height=45.0, density=0.4)
# rises to 3 MPa at 3 %, falls to a plateau of 2 MPa, then 2.2 MPa at 50 %, and densifies
FINE = np.arange(1201) / 2000
STRAIN = np.array([0, 0.03, 0.05, 0.1, 0.25, 0.5, 0.6])
STRESS = np.array([0, 3.0, 2.5, 2.0, 2.0, 2.2, 4.0])
KNOWN = {
    "plateau_stress": (51 * 2.0 + 150 * 2.0 + 0.0008 * 150 * 151 / 2) / 201,
    "energy_to_strain": 1.0375,
    "energy_efficiency_to_strain": 1.0375 / (3 * 0.5),
    "energy_25": 0.5125,
    "energy_40": 0.5125 + 0.15 * (2 + 2.12) / 2,
    "first_maximum": 3.0,
    "first_maximum_strain": 0.03,
    "gradient": 100.0,
    "offset_stress": 2.96,  # 3.75 - 25 e = 100 (e - .002)
    "proof_strength": 2.8,  # 3.75 - 25 e = 100 (e - .01)
    "densification_strain": 0.5,
    "efficiency_max": 1.0375 / 2.2,
    "energy_to_densification": 1.0375,
    "energy_per_mass": 1.0375 / 0.4,
    "stress_10": 2.0,
    "compressive_strength": 3.0,
    "yield_strength": 3.0,
    "effective_displacement": 1.35,
    "effective_energy": 3.0 * 2025 * 1.35 / 2 / 1000,
}
END = 0.5 + 0.1 * (1.3 * KNOWN["plateau_stress"] - 2.2) / 1.8
KNOWN["plateau_end"] = END
KNOWN["energy_to_plateau_end"] = 1.0375 + (END - 0.5) * (2.2 + 1.3 * KNOWN["plateau_stress"]) / 2


def numbers(strain, stress, specimen=SPECIMEN, **settings):
    return {measure.name: measure.value for measure in measures(strain, stress, specimen, **settings)}


def test_a_curve_of_straight_lines_has_its_known_measures():
    for strain in (STRAIN, FINE):
        found = numbers(strain, np.interp(strain, STRAIN, STRESS))
        for name, value in KNOWN.items():
            assert found[name] == pytest.approx(value, rel=1e-6), name
        assert found["elastic_gradient"] is None


def test_every_measure_says_how_it_is_defined_or_why_it_is_not_there():
    for measure in measures([0, 0.05, 0.15], [0, 1.0, 1.5]):
        assert measure.definition
        assert (measure.value is None) == bool(measure.remark), measure
    assert len({m.name for m in measures(STRAIN, STRESS)}) == len(measures(STRAIN, STRESS))


def test_a_curve_that_only_rises_has_no_maximum_and_no_densification():
    found = numbers(FINE, np.interp(FINE, [0, 0.05, 0.6], [0, 1.0, 1.2]))
    for name in ("first_maximum", "densification_strain", "energy_per_mass", "plateau_end", "compressive_strength"):
        assert found[name] is None, name
    assert found["gradient"] == pytest.approx(20)
    assert found["yield_strength"] == pytest.approx(1 + 0.2 * 0.45 / 0.55)  # up to 50 % strain


def test_noise_before_contact_is_no_maximum():
    stress = np.interp(FINE, STRAIN + 0.02, STRESS)
    stress[10:25:6] += 0.1
    assert numbers(FINE, stress)["first_maximum_strain"] == pytest.approx(0.05)


def test_a_fall_of_less_than_two_percent_is_no_maximum():
    curve = lambda low: numbers([0, 0.05, 0.1, 0.6], [0, 1.0, low, 2.0])["first_maximum"]  # noqa: E731
    assert curve(0.981) is None
    assert curve(0.979) == pytest.approx(1)


def test_unloading_gives_the_elastic_gradient_and_does_not_count_as_loading():
    there, back = np.arange(151) / 1000, 0.15 - np.arange(1, 21) / 2000
    loop = np.concatenate([there, back, back[::-1], np.arange(150, 601) / 1000])
    stress = np.interp(loop, STRAIN, STRESS)
    # 300 MPa between 70 % and 20 % of the plateau stress, less below and above
    shares, ways = np.array([1.0, 0.7, 0.2, 0.0]), np.cumsum([0.0, 0.3 / 200, 0.5 / 300, 0.2 / 100])
    plateau = KNOWN["plateau_stress"]
    stress[151:191] = np.interp(0.15 - loop[151:191], plateau * ways, plateau * shares)
    found = numbers(loop, stress)
    assert found["elastic_gradient"] == pytest.approx(300, rel=0.02)  # the corners lie between readings
    assert loading(loop, stress).stress == pytest.approx(np.interp(np.arange(601) / 1000, STRAIN, STRESS))
    steep = numbers(STRAIN, STRESS)
    for name in ("plateau_stress", "energy_to_strain", "gradient", "offset_stress", "densification_strain"):
        assert found[name] == pytest.approx(steep[name], rel=1e-6), name


def test_units():
    giga = numbers(STRAIN, STRESS / 1000, SPECIMEN._replace(unit="GPa"))
    assert giga["effective_energy"] == pytest.approx(KNOWN["effective_energy"], rel=1e-9)
    units = {m.name: m.unit for m in measures(STRAIN, STRESS, SPECIMEN)}
    assert units["effective_energy"] == "J"
    assert units["energy_per_mass"] == "J/g"
    relative = {m.name: m for m in measures(STRAIN, STRESS, SPECIMEN._replace(unit="relative"))}
    assert relative["energy_per_mass"].value is None
    assert relative["effective_energy"].unit == relative["plateau_stress"].unit == ""
    assert relative["effective_energy"].value == pytest.approx(0.045)


@pytest.mark.parametrize("seed", range(5))
def test_no_curve_has_more_energy_than_its_highest_force_times_its_way(seed):
    rng = np.random.default_rng(seed)
    strain = np.sort(rng.random(300)) * 0.6
    found = numbers(strain, rng.random(300) + 5 * strain)
    ratio = work_ratio(found["effective_energy"], found["yield_strength"], 2025, found["effective_displacement"])
    assert 0 < ratio <= 1
    assert found["energy_efficiency_to_strain"] <= 1
    assert found["efficiency_max"] is None or found["efficiency_max"] < 0.6


@pytest.mark.parametrize(
    ("strength", "way", "energy", "ratio"),
    [
        (1.7765, 2.6396, 6.065, 0.639),  # TPMS-P
        (1.4936, 5.2674, 16.11, 1.011),  # TPMS-L
        (1.6477, 2.3844, 8.357, 1.050),  # Kelvin
        (1.5488, 3.9342, 12.39, 1.004),  # Octet
        (0.5452, 20.2926, 20.93, 0.934),  # SPPM-1
    ],
)
def test_energies_of_the_paper_over_force_times_way(strength, way, energy, ratio):
    assert work_ratio(energy, strength, 45.0**2, way) == pytest.approx(ratio, abs=5e-4)


def test_what_is_no_curve_of_compression_is_refused():
    with pytest.raises(ValueError, match="0\\.003 or more"):
        measures([0, 0.002], [0, 1])
    with pytest.raises(ValueError, match="negative"):
        measures(STRAIN, -STRESS)


def test_the_mean_of_specimens_goes_to_the_end_of_the_shortest():
    strain, mean, spread = mean_and_spread([(STRAIN, STRESS), (STRAIN[:-1], 1.2 * STRESS[:-1])])
    assert strain[-1] == pytest.approx(0.5)
    known = np.interp(strain, STRAIN, STRESS)
    assert mean == pytest.approx(1.1 * known)
    assert spread == pytest.approx(0.2 * known / 2**0.5)


def test_a_curve_that_begins_late_rises_from_zero():
    curve = loading([0.01, 0.02], [1.0, 1.0])
    assert curve.stress_at(0.005) == pytest.approx(0.5)
    assert curve.work_to(0.02) == pytest.approx(0.015)


def test_readings_behind_the_farthest_one_are_no_loading():
    strain, stress = loading_branch([0, 0.1, 0.05, 0.1, 0.2], [0, 1, 5, 5, 2])
    assert strain.tolist() == [0, 0.1, 0.2]
    assert stress.tolist() == [0, 1, 2]


@pytest.mark.parametrize("window", [(0.2, 0.4), (0.3, 0.5)])
def test_the_plateau_is_the_mean_of_its_window_and_of_nothing_else(window):
    """A straight rise inside, and spikes just beyond both ends, that any other window would take in or miss."""
    strain = np.arange(601) / 1000
    stress = 1.0 + strain
    low, high = window
    stress[strain < low - 1e-9] = 50.0
    stress[strain > high + 1e-9] = 70.0
    mean = pytest.approx(1.0 + (low + high) / 2, rel=1e-9)
    assert numbers(strain, stress, plateau=window)["plateau_stress"] == mean
    assert mean_stress(strain, stress, low, high) == mean
    if window == PLATEAU:
        assert numbers(strain, stress)["plateau_stress"] == mean


def test_the_window_of_a_crushed_block_is_that_of_the_measures():
    assert PLATEAU == (0.2, 0.4)
