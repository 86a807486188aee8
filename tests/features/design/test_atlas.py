"""The atlas and `sppm find`: interpolation, bands, conditions, similarity, and rows that are made again."""

import numpy as np
import pytest

import sppm_pipeline as sppm
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.design.atlas import (
    DATA,
    FAMILIES,
    LENGTH_POWERS,
    PORES,
    PROPERTIES,
    Atlas,
    configuration,
    covariance,
    fitted,
    predicted,
    searched,
    spread,
)

QUERY = "E_relative > 0.05, porosity = 0.7, permeability * surface^2 > 0.01"


def test_a_parabola_is_reproduced():
    points, at = spread(30, 2), spread(200, 2)[30:]

    def values(p):
        return 1 + 2 * p[:, 0] - 3 * p[:, 1] + p[:, 0] * p[:, 1] + 0.5 * p[:, 1] ** 2

    fit = fitted(points, values(points), np.arange(30))
    assert predicted([fit], points, at)[:, 0] == pytest.approx(values(at), abs=0.03)
    assert fit.band < 0.03


def test_residuals_of_designs_left_out_are_those_of_a_fit_without_them():
    rng = np.random.default_rng(2)
    points = np.repeat(spread(8, 2), 2, axis=0)
    values = points.sum(1) + 0.1 * rng.normal(size=16)
    designs = np.repeat(np.arange(8), 2)
    fit = fitted(points, values, designs)
    length, rough, noise = fit.settings
    y = (values - fit.mean) / fit.deviation
    left = []
    for number in range(8):
        kept = designs != number
        inverse = np.linalg.inv(covariance(points[kept], points[kept], length, rough) + noise * np.eye(14))
        left.extend(y[~kept] - covariance(points[~kept], points[kept], length, rough) @ inverse @ y[kept])
    assert fit.band == pytest.approx(fit.deviation * np.sort(np.abs(left))[15], rel=1e-9)


def test_bands_hold_nine_of_ten_fresh_draws():
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(12):
        points, at = rng.random((60, 2)), rng.random((200, 2))
        noise = rng.normal(0, 0.2, 260)
        fit = fitted(points, np.sin(3 * points[:, 0]) + points[:, 1] + noise[:60], np.arange(60))
        error = predicted([fit], points, at)[:, 0] - np.sin(3 * at[:, 0]) - at[:, 1] - noise[60:]
        inside.append(np.abs(error) <= fit.band)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.03)


def test_the_rows_were_made_by_the_stages_as_they_are():
    atlas = Atlas.read()
    assert atlas.stale() == []
    assert DATA.stat().st_size < 1e6
    changed = {**atlas.arrays, "walls.versions": np.array(["field.walls=0"])}
    assert Atlas(changed).stale() == ["walls"]


@pytest.mark.filterwarnings("ignore::sppm_pipeline.SppmWarning")
def test_a_row_is_what_its_configuration_makes(tmp_path):
    """Equal digests need the same kind of processor; numbers are equal on all but for rounding."""
    atlas, family = Atlas.read(), "even"
    ranges = FAMILIES[family].ranges
    point = atlas.arrays[f"{family}.points"][0]
    values = {n: float(f"{a + s * (b - a):.4g}") for s, (n, (a, b)) in zip(point, ranges.items(), strict=True)}
    seed = 1000 * int(atlas.arrays[f"{family}.number"][0]) + int(atlas.arrays[f"{family}.draw"][0])
    text = "\n".join(line for line in configuration("row", family, values).splitlines() if "permeability" not in line)
    (tmp_path / "row.yaml").write_text(text)
    numbers = sppm.run(str(tmp_path / "row.yaml"), seed=seed, output=str(tmp_path / "run"), cache=False).numbers
    row = dict(zip(PROPERTIES, np.exp(atlas.arrays[f"{family}.values"][0].astype(float)), strict=True))
    assert numbers["homogenize.voxel.E_relative"] == pytest.approx(row["E_relative"], rel=1e-3)
    assert numbers["check.sizes.pore.mean"] == pytest.approx(row["pore"] * PORES ** (-1 / 3), rel=1e-3)


def test_designs_meet_the_conditions_and_differ():
    found = sppm.find(QUERY, cell="4 mm", maximize="permeability")
    assert 1 <= len(found) <= 5
    for one in found:
        values = {name: of[1] for name, of in one.values.items()}
        assert values["E_relative"] > 0.05
        assert values["permeability"] * values["surface"] ** 2 > 0.01
        assert one.parameters["porosity"] == 0.7
        assert all(low < value < high for low, value, high in one.values.values())
    permeabilities = [one.values["permeability"][1] for one in found]
    assert permeabilities == sorted(permeabilities, reverse=True)
    assert len({(one.family, *one.parameters.values()) for one in found}) == len(found)


def test_a_design_of_a_plugin_says_what_it_needs():
    for family in FAMILIES:
        text = configuration("one", family, {name: a for name, (a, _) in FAMILIES[family].ranges.items()}, cell="4 mm")
        assert ("pip install" in text) == (family in ("foam", "spinodoid"))
        assert "edge: 4 mm" in text


def test_twice_the_cell_has_twice_the_lengths():
    small, large = (sppm.find(QUERY, cell=cell, maximize="E_relative")[0] for cell in ("3 mm", "6 mm"))
    assert (small.family, small.parameters) == (large.family, large.parameters)
    for name, power in LENGTH_POWERS.items():
        assert large.values[name][1] == pytest.approx(2**power * small.values[name][1])


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("E_relative", "is no condition"),
        ("E_relative > 0.9", "no design of the atlas"),
        ("stiffness > 0.1", "there is no name 'stiffness'"),
        ("strut > 0.3 mm", "the size of the cell is missing"),
        ("porosity = 0.99", "no family has the porosity"),
        ("porosity = 0.7, porosity = 0.8", "no design of the atlas"),
    ],
)
def test_queries_that_can_not_be_answered_say_why(query, message):
    with pytest.raises(ConfigError, match=message):
        sppm.find(query)
    with pytest.raises(ConfigError, match="`cell` is"):
        sppm.find("E_relative > 0", cell="four")
    for wrong in ({"cell": "-4 mm"}, {"cell": "0 mm"}, {"count": 0}, {"count": -2}):
        with pytest.raises(ConfigError, match="should be above 0"):
            sppm.find("E_relative > 0", **wrong)


def test_the_verb_prints_designs_and_writes_configurations_that_check(tmp_path, capsys):
    folder = tmp_path / "found"
    assert main(["find", QUERY, "--cell", "4mm", "--count", "2", "--output", str(folder)]) == 0
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("1. ", "E_relative", "candidates meet"))
    assert sorted(path.name for path in folder.iterdir()) == ["found_1.yaml", "found_2.yaml", "pareto.png"]
    assert main(["check", str(folder / "found_1.yaml")]) == 0
    for taken in (folder, folder / "found_1.yaml"):
        assert main(["find", QUERY, "--output", str(taken)]) != 0
        assert "is no empty folder" in capsys.readouterr().err


def test_the_front_of_candidates_is_met_by_no_other():
    found, all_ = searched("porosity = 0.7", cell=None, count=3, maximize="E_relative")
    assert found[0].values["E_relative"][1] == pytest.approx(all_["E_relative"].max())


def test_the_largest_modulus_is_at_least_the_smallest():
    for one in sppm.find("E_relative > 0.02", cell="4 mm", count=20, minimize="E_ratio"):
        assert 1 <= one.values["E_ratio"][0] <= one.values["E_ratio"][1]
