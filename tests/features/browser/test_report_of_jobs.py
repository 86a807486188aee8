"""Jobs from CAD to print: their files hold together, and the first screen of a report answers what colleagues ask."""

import re
import runpy
import shutil
from pathlib import Path

import numpy as np
import pytest

from sppm_pipeline.engine.cli.main import main
from sppm_pipeline.services.mesh.adjacency import adjacency
from sppm_pipeline.services.mesh.measures import volume

JOBS = Path(__file__).resolve().parents[3] / "examples" / "jobs"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The jobs, with an insole of few triangles, and the bracket if Open CASCADE is there."""
    home = tmp_path_factory.mktemp("jobs")
    for file in JOBS.iterdir():
        if file.is_file():
            shutil.copy(file, home)
    parts = runpy.run_path(str(JOBS / "make_parts.py"))
    insole = parts["insole"](60, 24)
    assert (adjacency(insole.faces).opposite >= 0).all()
    assert 1.2e5 < volume(insole.vertices, insole.faces) < 1.6e5
    assert np.ptp(insole.vertices, axis=0) == pytest.approx([256, 88, 23], abs=3)
    parts["sppm"].write.mesh(insole, path="insole.stl", output=home)
    return home


@pytest.mark.parametrize("name", ["cube", "insole", "lattice", "rocker"])
def test_jobs_hold_together(folder, name):
    assert main(["check", str(folder / f"{name}.yaml")]) == 0


def test_the_bracket_is_read_with_its_holes(folder):
    pytest.importorskip("OCP", reason="needs Open CASCADE, which sppm-cad installs")
    pytest.importorskip("sppm_cad")
    runpy.run_path(str(JOBS / "make_parts.py"))["bracket"](folder / "bracket.step")
    assert main(["check", str(folder / "bracket.yaml")]) == 0


@pytest.mark.browser
def test_the_first_screen_says_weight_print_and_how_to_make_it_again(folder, browser):
    quick = ["-s", "read.primitive.size=[15 mm, 15 mm, 5 mm]", "-s", "extract.marching_cubes.resolution=12", "-s",
             "write.picture.resolution=8", "-s", "write.picture.image_size=[240, 180]"]  # fmt: skip
    run = folder / "run"
    assert main(["run", str(folder / "lattice.yaml"), "-o", str(run), "--report", "-p", "cell=5 mm", *quick]) == 0
    report = run / "report.html"
    assert report.stat().st_size < 5e6
    page = browser.new_page(viewport={"width": 1400, "height": 900})
    page.goto(report.as_uri())
    shown = page.evaluate(
        """() => [...document.querySelectorAll('.box, .facts > div')].filter(
             (e) => e.getBoundingClientRect().bottom <= innerHeight).map((e) => e.innerText.replace(/\\s+/g, ' '))"""
    )
    words = " | ".join(shown)
    assert re.search(r"resin [^|]* g", words), words
    assert "sppm run run.json" in words
    assert re.search(r"print [^|]*(trap|cups|islands|nothing)", words), words
    assert page.locator("#live-canvas").count() == 1
    page.close()
