"""Presets: recipes that are named and not written down."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from sppm_pipeline import Pipeline, hookspecs
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.errors import ConfigError
from sppm_pipeline.method.presets import PRESETS

TUNED = {"stage": "tune.porosity", "target": 0.7, "resolution": 24, "tolerance": 0.02}


def recipes_of(pipeline: Pipeline) -> dict[str, list[dict[str, object]]]:
    """The recipes as the pipeline's own YAML has them."""
    from ruamel.yaml import YAML

    found: dict[str, list[dict[str, object]]] = YAML(typ="safe", pure=True).load(pipeline.to_yaml(defaults=True))[
        "recipes"
    ]
    return found


def test_a_preset_is_a_recipe_of_its_name_with_its_defaults() -> None:
    found = recipes_of(Pipeline([{**TUNED, "recipe": "paper"}]))
    assert list(found) == ["paper"]
    faces, darts, joined, field = found["paper"]
    assert (faces["total"], faces["edge"], darts["total"]) == (95, 2, 95)
    assert joined["degree"] == [3, 5]
    assert (field["omega"], field["mu"], field["level"]) == (30, 30, 0.25)


def test_its_parameters_are_set_under_a_name_of_ones_own_and_may_be_parameters_of_the_file() -> None:
    pipeline = Pipeline(
        [{**TUNED, "recipe": "cell"}],
        recipes={"cell": {"preset": "stiff", "total": "${pores}", "stealth": 0.1}},
        params={"pores": 30},
    )
    faces, hyperuniform, *_ = recipes_of(pipeline)["cell"]
    assert faces["total"] == hyperuniform["total"] == "${pores}"
    assert hyperuniform["stealth"] == 0.1
    assert "edge" not in faces  # a parameter that is none leaves the option to the stage


def test_a_recipe_of_the_file_hides_the_preset() -> None:
    own = ["sample.mirrored_faces"]
    with pytest.raises(ConfigError, match="number of pores"):
        Pipeline([{**TUNED, "recipe": "stiff"}], recipes={"stiff": own}).to_yaml()


def test_what_is_wrong_is_said_once_with_what_was_meant() -> None:
    for recipe, words, hint in (
        ({"preset": "stif"}, "there is no preset 'stif'", "stiff"),
        ({"preset": "stiff", "totl": 3}, "the preset 'stiff' has no parameter 'totl'", "total"),
    ):
        with pytest.raises(ConfigError, match=words) as error:
            Pipeline([{**TUNED, "recipe": "cell"}], recipes={"cell": recipe}).to_yaml()
        assert hint in str(error.value.hint)
    with pytest.raises(ConfigError, match="there is no recipe 'stif'") as error:
        Pipeline([{**TUNED, "recipe": "stif"}]).to_yaml()
    assert "`sppm stages` lists presets" in str(error.value.hint)


@pytest.mark.filterwarnings("ignore:.*changes the radii")  # which are of no concern here
@pytest.mark.parametrize("name", sorted(PRESETS))
def test_the_presets_serve_cells_tile_sets_and_scattered_cells(name: str) -> None:
    small: dict[str, object] = {"preset": name, "total": 40}
    coarse = {"porosity": 0.7, "resolution": 16}
    stages = [
        {**TUNED, "recipe": "cell"},
        {"stage": "check.connectivity", "id": "cell", "resolution": 32},
        {"stage": "tileset.wang_3color", "recipe": "cell", "tolerance": 0.02, **coarse},
        {"stage": "tile.wang_3color", "cells": [2, 1, 1], "cell": 5},
        {"stage": "tile.scattered", "id": "tiled", "recipe": "cell", "cells": [2, 1, 1], "cell": 5, **coarse},
    ]
    run = Pipeline(stages, recipes={"cell": small}, seed=2).run(cache=False)
    assert 1 <= run.numbers["cell.void_components"] <= 3  # a coarse grid may show a pore closed
    assert run.numbers["cell.porosity"] == pytest.approx(0.7, abs=0.03)


def test_plugins_supply_presets_and_the_list_shows_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plugin = tmp_path / "crystal.py"
    plugin.write_text(
        """
from sppm_pipeline import hookimpl
from sppm_pipeline.nouns import Preset

@hookimpl
def sppm_presets():
    stages = [{"stage": "sample.elimination", "count": "${count}"}, "connect.mst", {"stage": "field.walls"}]
    return {"sparse": Preset("few pores", stages, {"count": 12})}
""",
        encoding="utf-8",
    )
    assert main(["stages", "--no-plugins", "--plugin", str(plugin)]) == 0
    assert re.search(r"  sparse +few pores", capsys.readouterr().out)
    assert main(["stages", "sparse", "--no-plugins", "--plugin", str(plugin)]) == 0
    assert '  - {stage: sample.elimination, count: "${count}"}' in capsys.readouterr().out
    file = tmp_path / "c.yaml"
    file.write_text(
        f"sppm: 1\nplugins: [{plugin.name}]\nname: sparse\npipeline: [{json.dumps({**TUNED, 'recipe': 'sparse'})}]\n"
    )
    assert main(["run", str(file), "-q", "-o", str(tmp_path / "run")]) == 0
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["config"]["recipes"]["sparse"][0]["stage"] == "sample.elimination"
    assert record["stages"][0]["summary"]["pores"] == 12


def test_the_hook_is_documented() -> None:
    assert "recipe: NAME" in str(hookspecs.sppm_presets.__doc__)
