"""``write.stiffness``: every file of the folder."""

import json

import numpy as np
import pytest
from PIL import Image

from sppm_pipeline.errors import ConfigError
from sppm_pipeline.features.stiffness.stages.write_stiffness import WriteStiffness, abaqus_constants
from sppm_pipeline.method.nouns.stiffness import StiffnessReport
from sppm_pipeline.services.elastic.voigt import isotropic
from sppm_pipeline.services.formats import ply
from sppm_pipeline.testing.plain_context import PlainContext
from tests.conftest import cubic

PHASES = ((0.4, 1.0, 0.3), (0.6, 0.0, 0.0))


def test_the_folder(tmp_path):
    stiffness = cubic(0.2, 0.06, 0.1)
    report = StiffnessReport(stiffness, PHASES, "a test", unit="MPa")
    WriteStiffness(image_size=(400, 300)).run(PlainContext(directory=tmp_path), report)
    folder = tmp_path / "stiffness"
    found = json.loads((folder / "stiffness.json").read_text())
    assert np.array(found["C"]) == pytest.approx(stiffness)
    assert found["unit"] == "MPa"
    card = (folder / "material.inp").read_text()
    assert "NAME=SPPM" in card
    assert "MPa" in card
    vertices, _ = ply.decode((folder / "young.ply").read_bytes(), "young.ply")
    assert np.linalg.norm(vertices, axis=1).max() == pytest.approx(1, abs=1e-6)
    # the modulus along x over the largest
    along = vertices[np.argmax(vertices[:, 0] / np.linalg.norm(vertices, axis=1))]
    assert np.linalg.norm(along) == pytest.approx(found["E"][0] / found["E_max"]["value"], abs=2e-3)
    with Image.open(folder / "young.png") as picture:
        assert picture.size == (400, 300)
        colors = len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0))
    assert colors > 500


def test_the_card_says_how_far_the_grid_may_be_off(tmp_path):
    stiffness = cubic(0.2, 0.06, 0.1)
    WriteStiffness(path="a").run(PlainContext(directory=tmp_path), StiffnessReport(stiffness, PHASES, "one grid"))
    assert "** error of the grid: not estimated" in (tmp_path / "a/material.inp").read_text()
    error = cubic(0.02, 0.003, 0.01)
    report = StiffnessReport(stiffness, PHASES, "two grids", error=error)
    WriteStiffness(path="b").run(PlainContext(directory=tmp_path), report)
    lines = (tmp_path / "b/material.inp").read_text().splitlines()
    start = lines.index("** error bar of each constant, in the order of the card:")
    rows = [line.removeprefix("**").split(",") for line in lines[start + 1 : start + 4]]
    assert [float(word) for row in rows for word in row] == pytest.approx(abaqus_constants(error))
    assert [len(row) for row in rows] == [len(line.split(",")) for line in lines[-3:]]
    found = report.summary()
    assert f"{found['E'][2]:.4g} +- {found['E_error'][2]:.2g}" in lines[start - 1]
    assert f"{np.linalg.norm(error) / np.linalg.norm(stiffness):.2%} of the stiffness" in lines[start - 1]


def test_nothing_stiff_is_said_and_the_rest_written(tmp_path):
    context = PlainContext(directory=tmp_path)
    WriteStiffness(path="s").run(context, StiffnessReport(np.zeros((6, 6)), PHASES, "a test"))
    assert "no stiffness" in context.warnings[0]
    assert (tmp_path / "s/material.inp").exists()
    assert not (tmp_path / "s/young.png").exists()
    assert json.loads((tmp_path / "s/stiffness.json").read_text())["nu"]["xy"] is None


def test_an_isotropic_material_has_one_color(tmp_path):
    report = StiffnessReport(isotropic(1.0, 0.3), ((1.0, 1.0, 0.3),), "a test")
    WriteStiffness(image_size=(300, 300)).run(PlainContext(directory=tmp_path), report)
    assert (tmp_path / "stiffness/young.png").exists()


def test_names_of_materials():
    with pytest.raises(ConfigError, match="letters"):
        WriteStiffness(material="*STEP").check_options()
