"""Numbers of the docs are those of their runs: pages fit the stored numbers, and cheap rows come out again.

If a page is stale, run ``python docs/generate_paper.py``; if a number has moved for a good reason,
``python docs/generate_paper.py --run NAME``.
"""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import sppm_pipeline as sppm
from benchmarks import independent
from tests.docs.conftest import ROOT, script

generator = script("generate_paper")
NAMES = generator.RUN
DEAR = {"bunny"}
"""Configurations of which no part is computed again: the mesh is not part of the repository."""
CHEAP = [name for name in NAMES if name not in DEAR]


def test_pages_are_those_of_the_stored_numbers() -> None:
    assert generator.stale() == [], "run python docs/generate_paper.py"


def test_every_result_is_computed_again() -> None:
    assert {name for name in NAMES if "cheap" not in generator.notes_of(name)} == DEAR


@pytest.mark.parametrize("name", CHEAP)
def test_numbers_come_out_again(name: str, tmp_path: Path) -> None:
    assert generator.differences(name, tmp_path) == []


def test_numbers_of_each_configuration_are_stored_and_no_others() -> None:
    assert {generator.file_of(name) for name in generator.RUN} == set(generator.RESULTS.glob("*.json"))


def test_pictures_are_shown_and_small() -> None:
    shown = {
        generator.picture_of(name, panel)
        for name in generator.RUN
        for panel in generator.notes_of(name).get("panels", ())
    }
    files = {path.name: path.stat().st_size for path in generator.PICTURES.glob("*.png")}
    assert set(files) == shown
    assert sum(files.values()) < 1_500_000


def test_every_figure_says_what_the_paper_shows() -> None:
    for name in generator.PAPER:
        notes = generator.notes_of(name)
        assert {"figure", "title", "paper"} <= set(notes), name
        assert not notes["paper"].endswith("."), name
        for entry in notes.get("numbers", ()):
            assert ("paper" in entry) == ("within" in entry), (name, entry["says"])


ROWS = [{"n": n, "kind": k, "y": y} for n, k, y in ((1, "a_x", 1.0), (1, "a_y", 3.0), (2, "b_x", 4.0), (2, "b_y", 8.0))]


@pytest.mark.parametrize(
    ("entry", "value", "error"),
    [
        ({}, 4.0, 2.943920 / 2),
        ({"where": {"n": 1}}, 2.0, 1.0),
        ({"where": {"kind": "b_*"}}, 6.0, 2.0),
        ({"where": {"kind": "b_x"}}, 4.0, None),
        ({"take": "largest"}, 8.0, None),
        ({"take": "least"}, 1.0, None),
        ({"take": "deviation", "where": {"n": 1}}, 2.0**0.5, None),
        ({"take": "relative deviation", "where": {"n": 1}}, 2.0**-0.5, None),
        ({"take": "largest from mean", "over": "n"}, 2.0, None),
        ({"over": "n"}, 2.5, 0.645497),
        ({"take": "mean reciprocal", "where": {"n": 1}}, 2 / 3, 1 / 3),
    ],
)
def test_numbers_of_rows(entry: dict, value: float, error: float | None) -> None:
    found = generator.measured(ROWS, {"column": "y", **entry})
    assert found.value == pytest.approx(value)
    assert found.error == (None if error is None else pytest.approx(error, rel=1e-6))


def test_the_squared_correlation_of_means() -> None:
    rows = [{"n": n, "y": y} for n, y in ((0, 0.0), (0, 2.0), (1, 2.0), (2, 6.0))]  # means 1, 2, 6
    found = generator.measured(rows, {"column": "y", "take": "squared correlation", "over": "n"})
    assert found.value == pytest.approx(25 / 28)


def test_the_exponent_of_a_spread():
    """Deviations of 0.8 / n^1.5 over means of 1, of two draws each, of which those beside count for other tables."""
    rows = [{"n": n, "y": 1 + sign * 0.8 * n**-1.5 / 2**0.5, "kind": "a"} for n in (1, 2, 4) for sign in (-1, 1)] + [
        {"n": 3, "y": 7.0, "kind": "b"}
    ]
    entry = {"column": "y", "over": "n", "where": {"kind": "a"}}
    found = generator.measured(rows, {**entry, "take": "exponent"})
    assert found.value == pytest.approx(0.5)
    logs = [3 * np.log(n) for n in (1, 2, 4)]
    assert found.error == pytest.approx(1 / (2 * 3 * np.var(logs)) ** 0.5)
    assert generator.measured(rows, {**entry, "take": "size for 5 %"}).value == pytest.approx((0.8 / 0.05) ** (2 / 3))


@pytest.mark.parametrize(
    ("value", "paper", "within", "said"),
    [
        (10, 10, 0, "yes"),
        (11, 10, 0, "**no**"),
        (10.9, 10, 0.1, "yes"),
        (11.1, 10, 0.1, "**no**"),
        (0.0005, [-0.001, 0.001], 0, "yes"),
        (-0.002, [-0.001, 0.001], 0, "**no**"),
    ],
)
def test_agreement_is_by_the_tolerance(value: float, paper: object, within: float, said: str) -> None:
    assert generator.agreement(generator.Measured(value, None, 1), {"paper": paper, "within": within}) == said


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [(0.19312, 0.00213, "0.1931 ± 0.0021"), (12.3, 1.7, "12.3 ± 1.7"), (27.0, None, "27"), (0.046123, None, "0.0461")],
)
def test_numbers_have_as_many_digits_as_their_errors(value: float, error: float | None, text: str) -> None:
    assert generator.text_of(generator.Measured(value, error, 9)) == text


def test_a_number_that_moves_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    name = "paper/worked_example"
    document = json.loads(generator.file_of(name).read_text(encoding="utf-8"))
    document["rows"][0]["scores.T3"] = 12
    changed: ModuleType = generator
    monkeypatch.setattr(changed, "RESULTS", tmp_path)
    changed.file_of(name).write_text(json.dumps(document), encoding="utf-8")
    assert changed.differences(name, tmp_path) == ["paper/worked_example, row 0: scores.T3 is 11, 12 is stored"]


def test_no_one_factor_on_the_solid_gives_all_strengths_of_the_paper():
    """What docs/explanation/crushing.md says of solids that differ by a factor in all their stresses."""
    rows = generator.stored("paper/compression").rows
    entries = [entry for entry in generator.notes_of("paper/compression")["numbers"] if "paper" in entry]
    ratios = {
        entry["says"]: generator.measured(rows, entry).value / entry["paper"]
        for entry in entries if entry["says"].startswith(("strength", "mean stress"))
    }  # fmt: skip
    strengths = {says: ratio for says, ratio in ratios.items() if says.startswith("strength")}
    agree = [{says for says, ratio in strengths.items() if abs(f * ratio - 1) <= 0.3} for f in np.arange(0.2, 3, 0.005)]
    assert max(map(len, agree)) == 7
    for factor in (0.6, 0.62, 0.65):
        missed = [says for says, ratio in strengths.items() if abs(factor * ratio - 1) > 0.3]
        assert missed == ["strength of ET-1 / MPa"], factor
    means = [0.62 * ratio for says, ratio in ratios.items() if says.startswith("mean stress")]
    assert means == pytest.approx([0.53, 0.73], abs=0.005)


def test_the_article_quotes_numbers_of_the_tables():
    """Each number with an error bar, and each with three digits behind the point, stands on a page of results."""
    article = (ROOT / "docs" / "paper" / "paper.md").read_text(encoding="utf-8").partition("# Functionality")[2]
    pages = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "explanation").glob("*.md"))
    tables = "\n".join(line for line in pages.splitlines() if line.startswith("|"))
    quoted = re.findall(r"\d\.\d+ ± \d\.\d+|\d\.\d{3,}", article)
    assert len(quoted) >= 5
    assert [number for number in quoted if number not in tables] == []
    cited = set(re.findall(r"@(\w+)", (ROOT / "docs" / "paper" / "paper.md").read_text(encoding="utf-8")))
    known = set(re.findall(r"@\w+\{(\w+),", (ROOT / "docs" / "paper" / "paper.bib").read_text(encoding="utf-8")))
    assert cited == known


@pytest.mark.filterwarnings("ignore::sppm_pipeline.SppmWarning")  # images are coarse, as they are for the other codes
def test_tables_beside_independent_codes_are_those_of_their_file():
    """Both pages show it, and our numbers in it come out again."""
    path = ROOT / "docs" / "results" / "independent.csv"
    for page, table in independent.tables(path).items():
        assert independent.MARK + table + independent.MARK in (independent.PAGES / page).read_text(encoding="utf-8")
    with path.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["cell"] == "paper 0.7 seed 1"]
    field = sppm.cell("paper", porosity=0.7, seed=1)
    for voxels, compute in (("16", independent.ours), ("32", independent.ours_of_void)):
        own = compute(np.ascontiguousarray(field.voxels(int(voxels)).values.T > 0))
        stored = {row["quantity"]: float(row["here"]) for row in rows if row["voxels"] == voxels}
        assert own == pytest.approx(stored, rel=1e-6), voxels
