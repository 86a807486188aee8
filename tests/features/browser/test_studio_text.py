"""Values are put into the text of a configuration, and nothing else of it changes."""

import difflib
import math

import pytest

from sppm_pipeline.engine.config.document import parse_yaml, plain
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.browser.studio.controls import places, with_values

FLOW = """\
sppm: 1   # the format
params: {pores: 90}  # of a cell
recipes:
  cell:
    - {stage: sample.dart_throwing, total: "${pores}", share: .5 }   # darts
    - stage: connect.mbdst   # joined
      degree: [3,   5]       # A and B

    # the field
    - stage: field.gaussian
      pore_radius: 0.11 # mm
      tunnel_radius:
        0.03
pipeline:
- {stage: tune.porosity, recipe: cell, target: 0.7}
"""


def changed_lines(before, after):
    return [line for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] in "+-"]


def test_only_the_values_change():
    text = with_values(
        FLOW, {"params.pores": 70, "recipes.cell.1.degree": [2, 4], "recipes.cell.2.tunnel_radius": 0.04}
    )
    assert changed_lines(FLOW, text) == [
        "- params: {pores: 90}  # of a cell",
        "+ params: {pores: 70}  # of a cell",
        "-       degree: [3,   5]       # A and B",
        "+       degree: [2,   4]       # A and B",
        "-         0.03",
        "+         0.04",
    ]


def test_what_is_not_there_is_written_behind_the_stage():
    values = {
        "seed": 4, "recipes.cell.0.gap": "0.2 mm", "recipes.cell.1.mode": "exact", "recipes.cell.1.neighbors": 8,
        "recipes.cell.2.level": 0.2, "pipeline.0.by": "gap",
    }  # fmt: skip
    text = with_values(FLOW, values)
    assert [line for line in changed_lines(FLOW, text) if line[0] == "+"] == [
        "+ seed: 4",
        '+     - {stage: sample.dart_throwing, gap: 0.2 mm, total: "${pores}", share: .5 }   # darts',
        "+       mode: exact",
        "+       neighbors: 8",
        "+       level: 0.2",
        "+ - {stage: tune.porosity, by: gap, recipe: cell, target: 0.7}",
    ]
    document = plain(parse_yaml(text, "x"))
    assert document["recipes"]["cell"][1] == {
        "stage": "connect.mbdst",
        "mode": "exact",
        "neighbors": 8,
        "degree": [3, 5],
    }
    assert document["seed"] == 4


@pytest.mark.parametrize(
    "value", ["true", "1e3", "null", "", "a: b", "#x", "x, y", "4 mm", " 4", "é", "no", "0x1", "-"]
)
def test_strings_stay_strings(value):
    text = with_values("sppm: 1\npipeline: [{stage: a.b, x: 1}]\n", {"pipeline.0.x": value})
    assert plain(parse_yaml(text, "x"))["pipeline"][0]["x"] == value


@pytest.mark.parametrize("value", [True, False, None, 3, -0.1, 1e-9, 1e22, [1, 2.5], ["a", None]])
def test_values_are_what_they_were(value):
    text = with_values("sppm: 1\npipeline: [{stage: a.b, x: }]\n", {"pipeline.0.x": value})
    assert plain(parse_yaml(text, "x"))["pipeline"][0]["x"] == value


def test_json_and_other_line_ends():
    text = with_values('{"sppm": 1, "pipeline": [{"stage": "a.b"}]}', {"pipeline.0.x": "w", "seed": 3})
    assert text == '{"sppm": 1, "seed": 3, "pipeline": [{"stage": "a.b", "x": "w"}]}'
    assert with_values("sppm: 1\r\npipeline: []\r\n", {"seed": 3}) == "sppm: 1\r\nseed: 3\r\npipeline: []\r\n"
    assert with_values("sppm: 1", {"seed": 3}) == "sppm: 1\nseed: 3"


def test_an_alias_is_the_place_of_its_anchor():
    text = "sppm: 1\npipeline:\n  - {stage: a.b, x: &x 3}\n  - {stage: c.d, y: *x}\n"
    assert "pipeline.1.y" not in places(text)
    changed = with_values(text, {"pipeline.0.x": 4})
    assert [entry["x" if i == 0 else "y"] for i, entry in enumerate(plain(parse_yaml(changed, "x"))["pipeline"])] == [
        4,
        4,
    ]


def test_a_place_that_is_nowhere():
    with pytest.raises(ConfigError, match=r"'pipeline\.7\.x'"):
        with_values(FLOW, {"pipeline.7.x": 1})


@pytest.mark.parametrize("empty", ["seed:\n", "seed: # none\n", "seed:   \n"])
def test_a_value_that_is_empty_is_written_behind_its_key(empty):
    text = f"sppm: 1\n{empty}name: a\n"
    assert plain(parse_yaml(with_values(text, {"seed": 3}), "a.yaml")) == {"sppm": 1, "seed": 3, "name": "a"}


def test_numbers_that_are_not_finite_are_refused():
    for value in (math.inf, math.nan):
        with pytest.raises(ConfigError, match="finite"):
            with_values("seed: 1\n", {"seed": value})
