"""The worked designs: their files check, and the core of the panel is what the atlas proposes.

Their numbers are computed again by ``tests/docs/test_paper.py``.
"""

from pathlib import Path

import pytest
from ruamel.yaml import YAML

import sppm_pipeline as sppm
from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.features.design.atlas import configuration

FOLDER = Path(__file__).parents[3] / "configs" / "designs"


@pytest.mark.parametrize("name", [path.stem for path in sorted(FOLDER.glob("*.yaml"))])
def test_each_file_checks_and_ends_with_a_file_for_the_machine(name, capsys):
    assert main(["check", str(FOLDER / f"{name}.yaml")]) == 0
    document = YAML(typ="safe").load((FOLDER / f"{name}.yaml").read_text())
    last = document["pipeline"][-1]
    assert last["stage"] in ("write.goo", "write.mesh")
    assert any(entry["stage"] == "check.print" for entry in document["pipeline"]) == (last["stage"] == "write.goo")


def test_the_core_of_the_panel_is_the_first_design_of_walls():
    query = "E_relative > 0.06, strut > 0.5 mm, pore < 3.5 mm"
    first = next(one for one in sppm.find(query, cell="9mm", maximize="porosity") if one.family == "walls")
    found = YAML(typ="safe").load(configuration("x", first.family, first.parameters, first.total))
    text = (FOLDER / "light_panel.yaml").read_text()
    panel = YAML(typ="safe").load(text)
    assert query in text
    assert panel["recipes"]["cell"] == found["recipes"]["cell"]
    assert panel["params"]["porosity"] == found["pipeline"][0]["target"]
    laid = {entry["cell"] for entry in panel["pipeline"] if entry["stage"] == "tile.scattered"}
    assert laid == {first.cell.replace("mm", " mm")}
