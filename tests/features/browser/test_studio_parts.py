"""Parts in the studio: what is shown at once, what it becomes, and that files and numbers are those of a run."""

import io
import json
import zipfile
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.engine.api.functions import make_function
from sppm_pipeline.engine.api.pipeline import Pipeline
from sppm_pipeline.engine.cli.new import design_text
from sppm_pipeline.engine.plan.session import RunRequest
from sppm_pipeline.engine.run.memory import run_in_memory
from sppm_pipeline.errors import ConfigError, InputError
from sppm_pipeline.features.browser.studio.design import START, Changed, Design
from sppm_pipeline.features.browser.studio.preview import BLOCK, quick_steps
from sppm_pipeline.features.browser.studio.server import Studio, configure, execute
from sppm_pipeline.services.grid import Grid

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # of small parts and few voxels


def write_box(folder, name="part.stl", size=(16.0, 8.0, 10.0)):
    mesh = make_function("read.primitive")(shape="box", size=[f"{side} mm" for side in size])
    (path,) = make_function("write.mesh")(mesh, path=name, output=folder)
    return Path(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_box(tmp_path_factory.mktemp("studio")).parent


def part(folder, kind="handle", printer=None, **more):
    text = design_text(kind, Path("part.stl"), "part", printer).replace("pixel: 0.05 mm", "pixel: 0.2 mm")
    text = text.replace("my_design.png, section", "my_design.png, resolution: 12, section")
    return Design(RunRequest("part.yaml", text=text, folder=str(folder), distributions=False), None, 2, **more)


@pytest.fixture(scope="module")
def handle(folder):
    return part(folder)


def test_the_part_is_shown_first(handle):
    assert handle.is_part
    assert handle.targets[0].name == "fix.drains"
    roles = [control.role for control in handle.controls["fix.drains"] if control.written]
    assert {"tile.scattered.cell", "tile.scattered.porosity", "fill.implicit.skin"} <= set(roles)


def test_a_preview_is_near_what_it_stands_for(handle):
    changes = {"params.porosity": 0.7}
    quick, view = handle.cell(changes, "fix.drains", quick=True)
    exact, fine = handle.cell(changes, "fix.drains")
    assert (quick["quick"], exact["quick"]) == (True, False)
    assert quick["yaml"] == exact["yaml"]
    assert quick["digest"] != exact["digest"]
    assert len(fine) > len(view)
    assert quick["part"]["porosity"] == pytest.approx(exact["part"]["porosity"], abs=0.03)
    assert quick["part"]["infill"] == pytest.approx(0.7, abs=0.03)
    assert exact["part"]["drains"] >= 1
    # the next preview has the holes that were found, as they are looked for on a grid of their own
    again, _ = handle.cell({"params.porosity": 0.72}, "fix.drains", quick=True)
    assert again["part"]["drains"] == exact["part"]["drains"]


def test_the_exact_part_is_that_of_the_command_line(handle, folder):
    said, _ = handle.cell({"pipeline.2.skin": "1.5 mm"}, "fix.drains")
    text = said["yaml"].replace('"part.stl"', json.dumps(str(folder / "part.stl")))
    assert Pipeline.from_yaml(text).run(until="fix.drains", cache=False)["fix.drains"].digest() == said["digest"]


def test_the_block_of_a_preview_repeats_and_has_the_porosity(handle):
    plan = handle._session.plan()
    steps = quick_steps(plan.steps)
    assert [step.stage.name for step in steps] == ["read.mesh", "tile.scattered", "fill.implicit"]

    tiling = run_in_memory(replace(plan, steps=steps[:2], plugins=()), threads=1).result("tile.scattered")
    assert tiling.tileset.micro.interiors == BLOCK**3
    first, second = (tiling.sample(Grid((x, 0.1, 0.2), (0.09,) * 3, (10, 16, 17))) for x in (0.05, 0.05 - BLOCK + 3))
    assert np.array_equal(first, second)
    n, whole = 12, tiling.cells
    grid = Grid((0.5 / n,) * 3, (1 / n,) * 3, tuple(n * c for c in whole))
    values = tiling.sample(grid)
    assert (values >= 0).mean() == pytest.approx(0.75, abs=0.05)  # of some cells of the block, more often than others


def test_what_changes_from_cell_to_cell_has_no_preview(folder):
    graded = part(folder, "panel")
    assert quick_steps(graded._session.plan().steps) is None


def test_stiffness_and_permeability_of_the_infill(handle):
    found = handle.numbers({}, "fix.drains")
    stiff, porosity = found["elastic"]["E"], found["elastic"]["porosity"]
    assert porosity == pytest.approx(0.75, abs=0.01)
    assert all(0 < value < 1 - porosity for value in stiff)  # the bound of Voigt
    assert found["flow"]["darcy_mean"] > 0


def test_a_run_gives_the_numbers_of_the_command_line_and_its_files(handle, folder, tmp_path):
    changes = {"params.porosity": 0.7}
    numbers = handle.run(changes)
    text = handle.text_with(changes).replace('"part.stl"', json.dumps(str(folder / "part.stl")))
    record = Pipeline.from_yaml(text).run(tmp_path / "run", cache=False).record
    written = next(stage["summary"] for stage in record["stages"] if stage["stage"] == "write.png")
    assert numbers["porosity"] == written["porosity"]
    assert numbers["solid_volume_mm3"] == written["solid_volume_mm3"]
    coarse = handle.cell(changes, "fix.drains")[0]["part"]
    assert coarse["porosity"] == pytest.approx(numbers["porosity"], abs=0.015)

    name, data = handle.file_of(changes, "fix.drains", "print")
    assert name == "slices.zip"
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        layers = [one for one in archive.namelist() if one.endswith(".png")]
        assert archive.read(layers[7]) == (tmp_path / "run" / layers[7]).read_bytes()
    name, data = handle.file_of(changes, "fix.drains", "picture")
    assert data == (tmp_path / "run" / name).read_bytes()
    name, data = handle.file_of(changes, "fix.drains", "stl")
    (tmp_path / name).write_bytes(data)
    surface = make_function("read.mesh")(path=str(tmp_path / name))
    assert surface.summary()["volume_mm3"] == pytest.approx(numbers["solid_volume_mm3"], rel=0.05)
    name, data = handle.file_of(changes, "fix.drains", "report")
    assert name == "part.html"
    assert b'id="live-canvas"' in data


def test_layers_that_take_long_are_made_on_request_only(folder):
    text = part(folder).text.replace("pixel: 0.2 mm", "pixel: 0.01 mm")
    request = RunRequest("part.yaml", text=text, folder=str(folder), distributions=False)
    assert Design(request, None, 2).run({})["expected_s"] > 20


def test_time_and_grams_are_those_of_the_printer(folder):
    made = part(folder, "handle", "prusa_sl1s")
    said, _ = made.cell({}, "fix.drains", quick=True)
    assert said["part"]["printer"] == "prusa_sl1s"
    assert said["part"]["g"] > 1000 * said["part"]["ml"] / 1000
    layers = 10 / 0.05
    assert said["part"]["seconds"] > layers * 1.0  # each is exposed for more than a second


@pytest.fixture
def studio(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return Studio(RunRequest("cell.yaml", text=START, folder=".", distributions=False), 2)


def test_a_mesh_beside_the_configuration_can_be_saved(studio, tmp_path):
    write_box(tmp_path)
    studio.begin(Path("part.stl"), "infill", None)
    made = studio.shown[0]
    assert made.file == Path("part_infill.yaml")
    assert not made.file.exists()
    made.save({"params.strut": "0.7 mm"})
    assert "strut: 0.7 mm" in made.file.read_text(encoding="utf-8")
    with made.file.open("a", encoding="utf-8") as file:
        file.write("# mine\n")
    with pytest.raises(Changed, match="changed by someone else"):
        made.save({"params.strut": "0.9 mm"})
    # what was edited by hand is what is opened the next time
    studio.begin(Path("part.stl"), "infill", None)
    again = studio.shown[0]
    assert again.text.endswith("# mine\n")
    again.save({"params.strut": "0.9 mm"})
    assert again.file.read_text(encoding="utf-8").endswith("# mine\n")


def test_a_file_that_came_meanwhile_is_not_overwritten(studio, tmp_path):
    write_box(tmp_path)
    studio.begin(Path("part.stl"), "infill", None)
    Path("part_infill.yaml").write_text("mine\n", encoding="utf-8")
    with pytest.raises(Changed):
        studio.shown[0].save({})
    assert Path("part_infill.yaml").read_text(encoding="utf-8") == "mine\n"


def test_meshes_are_dropped(studio, tmp_path):
    data = write_box(tmp_path).read_bytes()
    studio.drop("part.stl", data)
    assert studio.shown[0].file == Path("part_infill.yaml")  # it is the one that lies here
    studio.drop("../../other name.stl", data)
    assert studio.shown[0].file is None
    assert studio.mesh.name == "other name.stl"
    assert not (tmp_path / "other name.stl").exists()
    assert 'path: "other name.stl"' in studio.shown[0].text
    studio.shown[0].cell({}, "fix.drains", quick=True)
    # another printer, with the values that were changed
    studio.begin(studio.mesh, "infill", "prusa_sl1s", {"params.pore": "1.9 mm", "params.gone": 3})
    text = studio.shown[0].text
    assert "pore: 1.9 mm" in text
    assert "write.sl1" in text


@pytest.mark.parametrize("name", ["part.exe", "part", ".stl", "../..", "C:\\", ""])
def test_other_files_are_refused(studio, name):
    before = studio.shown
    with pytest.raises(InputError, match="is no mesh"):
        studio.drop(name, b"solid\n")
    assert studio.shown is before


def test_a_mesh_that_can_not_be_read_says_so_when_it_is_drawn(studio):
    studio.drop("part.stl", b"\x00" * 90)
    with pytest.raises(InputError):
        studio.shown[0].cell({}, "fix.drains", quick=True)


def test_step_files_are_read_by_the_plugin(folder):
    assert '{stage: read.cad, path: "a.step"}' in design_text("infill", Path("a.step"), "a", None)


def test_arguments_that_contradict(tmp_path):
    parser = ArgumentParser()
    configure(parser)
    with pytest.raises(ConfigError, match="is no file"):
        execute(parser.parse_args([str(tmp_path / "no.stl")]))
    with pytest.raises(ConfigError, match="what a mesh is made to"):
        execute(parser.parse_args(["--design", "cage"]))
    mesh = write_box(tmp_path)
    with pytest.raises(ConfigError, match="there is no design 'cagge'"):
        execute(parser.parse_args([str(mesh), "--design", "cagge"]))
